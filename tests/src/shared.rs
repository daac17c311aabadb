//! What several tests need: the models, and where the shared captures and motion lie.

use std::{
    path::{Path, PathBuf},
    sync::OnceLock,
};

use posed::models::Models;

/// The repository's root.
pub(crate) fn root() -> PathBuf {
    let tests = Path::new(env!("CARGO_MANIFEST_DIR"));
    tests
        .parent()
        .expect("the tests lie in the repository")
        .to_path_buf()
}

/// A path below the shared folder: `POSED_SHARED`, else `../shared` beside the repository.
/// Where it is missing, this says so, and the test is to return.
pub(crate) fn shared(relative: &str) -> Option<PathBuf> {
    let folder = std::env::var_os("POSED_SHARED")
        .map_or_else(|| root().with_file_name("shared"), PathBuf::from);
    let path = folder.join(relative);
    if path.exists() {
        return Some(path);
    }
    println!("SKIPPED (needs shared data): {relative}");
    None
}

/// The built-in models; a process can load them once only.
pub(crate) fn models() -> &'static Models {
    static MODELS: OnceLock<Models> = OnceLock::new();
    MODELS.get_or_init(|| Models::load().expect("ONNX Runtime is fetched by make native"))
}

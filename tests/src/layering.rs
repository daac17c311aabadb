//! The rooms' walls: which crate may depend on which, and who may name what.

use std::{collections::BTreeSet, fs, path::Path};

use cargo_metadata::{DependencyKind, MetadataCommand};

use crate::shared::root;

/// What each room may not depend on: other rooms and outside crates.
const FORBIDDEN: [(&str, &[&str]); 5] = [
    (
        "posed-signal",
        &[
            "tokio",
            "serde",
            "tracing",
            "posed-device",
            "posed-body",
            "posed-tracker",
            "posed-proto",
            "posed",
        ],
    ),
    (
        "posed-device",
        &[
            "posed-body",
            "posed-tracker",
            "posed-proto",
            "posed",
            "ort",
            "tokio",
        ],
    ),
    (
        "posed-body",
        &[
            "posed-device",
            "tokio",
            "ort",
            "posed-tracker",
            "posed-proto",
            "posed",
        ],
    ),
    (
        "posed-tracker",
        &["posed-device", "tokio", "tonic", "posed-proto", "posed"],
    ),
    (
        "posed-proto",
        &[
            "posed-signal",
            "posed-device",
            "posed-body",
            "posed-tracker",
            "posed",
            "ort",
        ],
    ),
];

/// Every crate that `start` needs to run, itself left out.
fn needs(metadata: &cargo_metadata::Metadata, start: &str) -> BTreeSet<String> {
    let resolve = metadata
        .resolve
        .as_ref()
        .expect("cargo metadata resolves the workspace");
    let name_of = |id: &cargo_metadata::PackageId| metadata[id].name.to_string();
    let first = resolve.nodes.iter().find(|node| name_of(&node.id) == start);
    let mut waiting = vec![first.expect("the crate is in the workspace")];
    let mut seen = BTreeSet::new();
    while let Some(node) = waiting.pop() {
        let normal = |dep: &&cargo_metadata::NodeDep| {
            dep.dep_kinds
                .iter()
                .any(|kind| kind.kind == DependencyKind::Normal)
        };
        for dep in node.deps.iter().filter(normal) {
            if seen.insert(name_of(&dep.pkg)) {
                waiting.push(&resolve[&dep.pkg]);
            }
        }
    }
    seen
}

#[test]
fn rooms_depend_one_way() {
    let metadata = MetadataCommand::new()
        .manifest_path(root().join("Cargo.toml"))
        // Loom's model checking is a build of its own, for no platform that posed runs on.
        .other_options(vec![
            "--locked".into(),
            "--filter-platform".into(),
            "x86_64-unknown-linux-gnu".into(),
        ])
        .exec()
        .expect("cargo metadata runs");
    for (room, forbidden) in FORBIDDEN {
        let needs = needs(&metadata, room);
        for name in forbidden {
            assert!(!needs.contains(*name), "{room} may not depend on {name}");
        }
    }
}

/// Every Rust source file of the workspace with its path relative to the root.
pub(crate) fn sources() -> Vec<(String, String)> {
    let mut found = Vec::new();
    for room in ["drivers", "policy", "proto", "daemon", "tests"] {
        collect(&root().join(room), &mut found);
    }
    assert!(
        found.len() > 20,
        "the sources are where they are looked for"
    );
    found.sort();
    found
}

fn collect(folder: &Path, found: &mut Vec<(String, String)>) {
    for entry in fs::read_dir(folder)
        .expect("a room can be listed")
        .flatten()
    {
        let path = entry.path();
        if path.is_dir() && path.file_name().is_some_and(|name| name != "target") {
            collect(&path, found);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            let text = fs::read_to_string(&path).expect("sources are UTF-8");
            let relative = path.strip_prefix(root()).expect("below the root");
            found.push((relative.to_string_lossy().into_owned(), text));
        }
    }
}

/// The part of a source file before its tests; nothing of a file that holds tests only.
fn production<'a>(path: &str, text: &'a str) -> &'a str {
    let tests_only = path.ends_with("/tests.rs") || path.contains("/tests/");
    let text = if tests_only { "" } else { text };
    let ends = ["#[cfg(test)]", "#[cfg(all(test"].map(|mark| text.find(mark));
    let end = ends.into_iter().flatten().min().unwrap_or(text.len());
    &text[..end]
}

#[test]
fn only_one_file_names_onnx_runtime() {
    let users: Vec<_> = sources()
        .into_iter()
        .filter(|(path, text)| {
            path.starts_with("policy/tracker/src")
                && text
                    .lines()
                    .any(|line| line.contains("ort::") && !line.contains("port::"))
        })
        .map(|(path, _)| path)
        .collect();
    assert_eq!(users, ["policy/tracker/src/inference.rs"]);
}

#[test]
fn only_one_file_converts_between_domain_and_protocol() {
    let both = |text: &str| text.contains("posed_proto::") && text.contains("posed_tracker::");
    let users: Vec<_> = sources()
        .into_iter()
        .filter(|(path, text)| path.starts_with("daemon/src") && both(production(path, text)))
        .map(|(path, _)| path)
        .collect();
    assert_eq!(users, ["daemon/src/grpc/convert.rs"]);
}

#[test]
fn only_the_daemon_reads_the_clock_and_the_environment_and_spawns_threads() {
    const RESERVED: [&str; 6] = [
        "Instant::now",
        "SystemTime::now",
        "thread::spawn",
        "thread::sleep",
        "env::var",
        "thread::Builder",
    ];
    for (path, text) in sources() {
        let room = path.starts_with("drivers/") || path.starts_with("policy/");
        if !room || !path.contains("/src/") {
            continue;
        }
        for name in RESERVED {
            assert!(
                !production(&path, &text).contains(name),
                "{path} uses {name}"
            );
        }
    }
}

#[test]
fn there_are_no_mutable_statics() {
    for (path, text) in sources() {
        if path.starts_with("tests/") {
            continue;
        }
        for line in production(&path, &text).lines() {
            let line = line.trim_start();
            let is_static = line.starts_with("static ") || line.starts_with("pub static ");
            let mutable = [
                "static mut",
                "Mutex<",
                "RwLock<",
                "OnceLock<",
                "LazyLock<",
                "Atomic",
            ]
            .iter()
            .any(|word| line.contains(word));
            assert!(!(is_static && mutable), "{path}: {line}");
        }
    }
}

//! The unit files, judged by systemd's own tools where they are installed.

use std::{
    env, fs, io,
    path::{Path, PathBuf},
    process::Command,
};

/// The most that `systemd-analyze security` may find in the sandboxed service, in tenths.
const EXPOSURE_MAX: u32 = 20;

fn unit(name: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../systemd")
        .join(name);
    fs::read_to_string(path).unwrap()
}

/// A copy of the units in which posed is a program that exists.
fn installed() -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let program = env::current_exe().unwrap();
    let service =
        unit("posed.service").replace("=posed run", &format!("={} run", program.display()));
    assert!(
        service.contains(&program.display().to_string()),
        "the service runs posed"
    );
    let path = folder.path().join("posed.service");
    fs::write(&path, service).unwrap();
    fs::write(folder.path().join("posed.socket"), unit("posed.socket")).unwrap();
    (folder, path)
}

/// Runs `systemd-analyze`; `None` where there is none. Gives what it printed if it found fault.
fn analyze(folder: &Path, arguments: &[&str]) -> Option<Result<(), String>> {
    let output = Command::new("systemd-analyze")
        .args(arguments)
        .current_dir(folder)
        .env("XDG_RUNTIME_DIR", folder)
        .output();
    match output {
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            println!("SKIPPED (needs systemd-analyze)");
            None
        }
        Err(error) => panic!("systemd-analyze: {error}"),
        Ok(output) => {
            let said = [output.stdout, output.stderr].concat();
            let said = String::from_utf8_lossy(&said).into_owned();
            Some(if output.status.success() {
                Ok(())
            } else {
                Err(said)
            })
        }
    }
}

#[test]
fn systemd_finds_no_fault_in_the_units() {
    let (folder, _) = installed();
    let options = ["verify", "--user", "--man=no", "--recursive-errors=no"];
    let units = ["./posed.service", "./posed.socket"];
    if let Some(verdict) = analyze(folder.path(), &[&options[..], &units[..]].concat()) {
        assert_eq!(verdict, Ok(()));
    }
}

#[test]
fn the_sandboxed_service_is_hardly_exposed() {
    let (folder, path) = installed();
    let drop_ins = path.with_extension("service.d");
    fs::create_dir(&drop_ins).unwrap();
    fs::write(drop_ins.join("sandbox.conf"), unit("sandbox.conf")).unwrap();
    let threshold = format!("--threshold={EXPOSURE_MAX}");
    let options = [
        "security",
        "--offline=yes",
        "--no-pager",
        &threshold,
        "./posed.service",
    ];
    if let Some(verdict) = analyze(folder.path(), &options) {
        assert_eq!(verdict, Ok(()));
    }
}

#[test]
fn the_socket_unit_listens_where_clients_look() {
    let socket = unit("posed.socket");
    assert!(
        socket
            .lines()
            .any(|line| line == "ListenStream=%t/posed/posed.sock")
    );
    assert!(socket.lines().any(|line| line == "SocketMode=0600"));
}

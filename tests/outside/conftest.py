"""posed as programs that are not posed see it: a browser, clients, readers of files."""

import contextlib
import dataclasses
import os
import pathlib
import shutil
import socket
import subprocess
import threading

import pytest
from playwright.sync_api import sync_playwright

ROOT = pathlib.Path(__file__).resolve().parents[2]
POSED = ROOT / "target/debug/posed"
# .ci/run looks for this text.
SKIPPED = "SKIPPED (needs {})"


def skip(what: str) -> None:
    pytest.skip(SKIPPED.format(what))


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@dataclasses.dataclass
class Demo:
    """A running `posed demo`."""

    grpc: str
    page: str
    recordings: pathlib.Path
    process: subprocess.Popen

    def posed(self, *args: str) -> str:
        """The output of a command to it."""
        command = [POSED, *args, "--server", self.grpc]
        return subprocess.run(command, check=True, capture_output=True, text=True, timeout=30).stdout


@contextlib.contextmanager
def running_demo(folder: pathlib.Path):
    """`posed demo` with its files in `folder`; its output is read, so that it never waits."""
    grpc, page = (f"127.0.0.1:{free_port()}" for _ in range(2))
    process = subprocess.Popen(
        [POSED, "demo", "--loop", "--seconds", "300", "--listen", grpc, "--page", page],
        env=os.environ | {"XDG_STATE_HOME": str(folder)},
        stdout=subprocess.PIPE,
        text=True,
    )
    said = []
    for line in process.stdout:
        said.append(line)
        if "live page is at" in line:
            break
    assert said and "live page is at" in said[-1], said
    threading.Thread(target=lambda: list(process.stdout), daemon=True).start()
    yield Demo(grpc, f"http://{page}/", folder / "posed/recordings", process)
    if process.poll() is None:
        process.terminate()
    process.wait(timeout=20)


@pytest.fixture(scope="session")
def demo(tmp_path_factory):
    with running_demo(tmp_path_factory.mktemp("state")) as demo:
        yield demo
    assert demo.process.returncode == 0


@pytest.fixture(scope="session")
def browser():
    """Chromium without a window or a graphics card."""
    program = shutil.which("chromium") or shutil.which("chromium-browser")
    if program is None:
        skip("a browser")
    with sync_playwright() as tools:
        drawing = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
        launched = tools.chromium.launch(
            executable_path=program, args=["--no-sandbox", "--disable-dev-shm-usage", *drawing]
        )
        yield launched
        launched.close()

"""The example clients, as somebody who writes a game would run them."""

import re
import subprocess
import sys

from conftest import POSED, ROOT

EXAMPLES = ROOT / "daemon/examples"
POSES = 20
LINE = re.compile(
    r"pose (\d+) \(QUALITY_(FULL|PARTIAL|DEGRADED|HELD)\): head at (\S+) (\S+) (\S+) m, "
    r"measured (\S+) ms before, \d+ skipped"
)


def check(output: str) -> None:
    """Poses in order, of somebody who stands on the floor."""
    found = [LINE.fullmatch(line) for line in output.splitlines()]
    assert len(found) == POSES and all(found), output
    numbers = [int(match[1]) for match in found]
    assert numbers == sorted(set(numbers)), numbers
    assert all(0.8 < float(match[4]) < 1.9 for match in found), output


def wait_until_tracked(demo) -> None:
    """The capture begins before the headset is found; a pose of one is followed from there."""
    for line in subprocess.run(
        [POSED, "follow", "--server", demo.grpc, "--json", "--count", "400"],
        capture_output=True, text=True, timeout=60, check=True,
    ).stdout.splitlines():
        if '"full"' in line:
            return
    raise AssertionError("no pose of full quality in 400")


def test_python(demo):
    wait_until_tracked(demo)
    command = [sys.executable, EXAMPLES / "follow.py", demo.grpc, str(POSES)]
    ran = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert ran.returncode == 0, ran.stderr
    check(ran.stdout)


def test_rust(demo):
    wait_until_tracked(demo)
    command = [ROOT / "target/debug/examples/follow", f"http://{demo.grpc}", str(POSES)]
    ran = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert ran.returncode == 0, ran.stderr
    check(ran.stdout)


def test_the_command_line_controls_a_running_posed(demo):
    assert "starts anew" in demo.posed("reset")
    assert demo.posed("height", "1.7") == "1.70 m\n"
    assert demo.posed("height") == "1.70 m\n"
    demo.posed("height", "1.75")
    assert "* ik" in demo.posed("tracker", "ik")
    assert "* hmd_nemo" in demo.posed("tracker", "hmd_nemo")
    assert "calibrated" in demo.posed("calibrate", "straight", "--seconds", "0")
    refused = subprocess.run(
        [POSED, "record", "stop", "--server", demo.grpc],
        capture_output=True, text=True, timeout=30,
    )
    assert refused.returncode == 1 and "nothing is being recorded" in refused.stderr

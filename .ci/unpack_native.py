"""Take the shared libraries out of the pinned wheels."""

import pathlib
import sys
import zipfile

WANTED = {
    "mujoco/libmujoco.so.3.17.0": "libmujoco.so.3.17.0",
    "onnxruntime/capi/libonnxruntime.so.1.31.1": "libonnxruntime.so.1.31.1",
}
# Linkers look for the bare name.
LINKS = {"libmujoco.so": "libmujoco.so.3.17.0"}


def main(wheels: pathlib.Path, lib: pathlib.Path) -> None:
    missing = dict(WANTED)
    for wheel in sorted(wheels.glob("*.whl")):
        with zipfile.ZipFile(wheel) as archive:
            for member in archive.namelist():
                if member in missing:
                    (lib / missing.pop(member)).write_bytes(archive.read(member))
    if missing:
        sys.exit(f"these files are not in the wheels under {wheels}: {sorted(missing)}")
    for link, target in LINKS.items():
        (lib / link).symlink_to(target)


if __name__ == "__main__":
    main(pathlib.Path(sys.argv[1]), pathlib.Path(sys.argv[2]))

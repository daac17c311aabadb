"""Stage (a): reference files to training motion. `python -m questsim.prepare --help`."""

import argparse
import re

from . import motion


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("references", help="file written by the Rust example `references`")
    parser.add_argument("out")
    parser.add_argument("--names", default=".", help="regular expression of the clips' names")
    parser.add_argument("--every", type=int, default=1, help="take every nth of them")
    parser.add_argument("--longest", type=int, help="cut clips after so many frames (36 a second)")
    args = parser.parse_args()
    pattern, seen = re.compile(args.names), [0]

    def wanted(name):
        if not pattern.search(name):
            return False
        seen[0] += 1
        return (seen[0] - 1) % args.every == 0

    made = motion.load(args.references, wanted, longest=args.longest)
    made.save(args.out)
    print(f"{len(made)} clips of {-(-seen[0] // args.every)} are feasible, "
          f"{len(made.qpos) / motion.RATE / 60:.1f} minutes, {len(made.characters)} characters")


if __name__ == "__main__":
    main()

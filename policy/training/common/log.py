"""What a training run tells of itself."""

import csv
import json
from pathlib import Path


def append(path, row):
    """A row of a CSV file, with its header where the file is new."""
    new = not path.exists()
    with path.open("a", newline="") as file:
        writer = csv.writer(file)
        if new:
            writer.writerow(row)
        writer.writerow([f"{v:.6g}" if isinstance(v, float) else v for v in row.values()])


def record(path, row):
    """A line of JSON at the end of a file, and printed."""
    line = json.dumps(row)
    with open(path, "a") as file:
        print(line, file=file)
    print(line, flush=True)


def cut(path, key, last):
    """Takes away the lines of `record` beyond `last` by `key`: a run that goes on makes them again."""
    path = Path(path)
    if path.exists():
        lines = path.read_text().splitlines(keepends=True)
        path.write_text("".join(line for line in lines if json.loads(line)[key] <= last))


class Log:
    """Losses averaged over 50 steps to `train.csv`, validation to `validation.jsonl`."""

    def __init__(self, out, columns):
        self.out, self.columns = out, columns
        self.sums, self.count = {}, 0

    def losses(self, run, named):
        for name, value in named.items():
            self.sums[name] = self.sums.get(name, 0.0) + value
        self.count += 1
        if run.step % 50 == 0:
            means = {k: v / self.count for k, v in self.sums.items()}
            append(self.out / "train.csv", {"step": run.step, "seconds": run.seconds, **means})
            print(run.step, f"{run.seconds:.0f}s",
                  " ".join(f"{k}={v:.4f}" for k, v in means.items()), flush=True)
            self.sums, self.count = {}, 0

    def validation(self, run, value, result):
        """`result` has a row for each set; `columns` of it are printed."""
        row = {"step": run.step, "seconds": run.seconds, "score": value,
               "stride": run.args.stride, "table": result}
        with (self.out / "validation.jsonl").open("a") as file:
            file.write(json.dumps(row) + "\n")
        errors = {k: [round(r[n], 2) for n in self.columns] for k, r in result.items()}
        print(run.step, f"{run.seconds:.0f}s", f"{value:.3f}", errors, flush=True)

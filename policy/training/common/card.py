"""What every model card says."""

LICENCES = {
    "bandai": ("bandai: Bandai-Namco-Research-Motiondataset", "CC BY-NC 4.0"),
    "cmu": ("cmu_*: CMU Graphics Lab Motion Capture Database, mocap.cs.cmu.edu, NSF EIA-0196217",
            "free for research and commercial use with credit"),
    "snu": ("snu: snumrl/DataDrivenBipedController", "MIT"),
    "fubot": ("fubot: Tomiha/FuBoT-VR-Dataset", "MIT"),
    "reactidle": ("reactidle: Enekoassets/ReActIdle", "MIT"),
    "sitting": ("sitting: made up by `posed_mocap.sitting`, no recorded data", "that of posed"),
}


def data(training):
    """A Markdown table of the sets that were trained on, with their licences."""
    used = training["arguments"]["sets"].split(",")
    rows = [f"| {name} | {terms} |" for source, (name, terms) in LICENCES.items()
            if any(each.startswith(source) for each in used)]
    return "\n".join(["| set | licence |", "|---|---|", *rows]) + "\n"


def flags(training, names):
    """The command-line flags `names` of a training that differ from their absence."""
    return " ".join(
        f"--{k.replace('_', '-')} {v}" for k, v in training["arguments"].items()
        if k in names and v not in ("None", "False")
    )


def metric_table(metrics, columns, more=()):
    """A Markdown table of an evaluation's JSON, or a line that says there is none.

    `columns`: (key, title); `more`: (title, function of a row) before them.
    """
    if not metrics:
        return "Not evaluated.\n"
    titles = ["set", "clips", *(t for t, _ in more), *(t for _, t in columns)]
    rows = ["| " + " | ".join(titles) + " |", "|" + "---|" * len(titles)]
    for name, row in metrics.items():
        cells = [name, str(row["clips"]), *(f(row) for _, f in more),
                 *(f"{row[k]:.2f}" for k, _ in columns)]
        rows.append("| " + " | ".join(cells) + " |")
    return "\n".join(rows) + "\n"

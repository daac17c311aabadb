import os
import sys
from pathlib import Path

import pytest
import torch

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))
torch.set_num_threads(1)


@pytest.fixture
def shared_mocap():
    """The shared mocap folder, or a skip that says so."""
    base = Path(os.environ.get("POSED_SHARED", ROOT.parents[1].parent / "shared"))
    folder = base / "mocap"
    if not folder.is_dir():
        print("SKIPPED (needs shared data)")
        pytest.skip("SKIPPED (needs shared data)")
    return folder

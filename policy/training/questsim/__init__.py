"""QuestSim (Winkler et al., SIGGRAPH Asia 2022): a torque policy that tracks sparse devices."""

import os

# Matrices here are small and many: threads would only wait for each other. NumPy reads this once.
for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")

"""Motion capture for training: the 22-joint skeleton, rotations and the data sets."""

"""PIP's kinematics networks (Yi et al., CVPR 2022): six inertial sensors to a moving body."""

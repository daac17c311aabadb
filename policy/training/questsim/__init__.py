"""QuestSim (Winkler et al., SIGGRAPH Asia 2022): a torque policy that tracks sparse devices."""

"""What the trainings share: schedule, optimizer, checkpoints, logs, lanes, export, golden motion."""

"""HMD-NeMo: full-body motion from a headset and two hands that may be out of view."""

"""The cell in lockstep with a source: one sample in, one prediction out."""

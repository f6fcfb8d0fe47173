"""Beside a running robot: its rows checked and put on one clock, the twin and estimators beside them, kept and shown."""

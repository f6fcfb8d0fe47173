"""Beside a running robot: its rows on one clock, the twin and estimators beside them, all of it kept and shown."""

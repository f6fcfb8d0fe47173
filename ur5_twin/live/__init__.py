"""The twin beside a running robot.

clock     the robot's stamps made one time: what is lost, late, repeated, or jumps
ring      the last minutes, in memory
follow    each row through the twin and the estimators, into ring and journal
session   connecting, losing the connection and connecting again
"""

"""The runs of kufieta2014 by what they are; a folder ``Movement_<name>`` each."""

from __future__ import annotations

#: Free motion, all with the accelerometer on the flange.
FREE = (
    "No3_Acc",
    "No4_Acc",
    "No5_Acc_slow_no_disturbance",
    "No6_Acc_slow_Verify_Model",
    "No9_Singularity_Free_NoDist",
)
#: The run of the thesis' tables 6.1 and 6.2, and the others with pushes and a force sensor.
THESIS_RUN = "No9_Singularity_Free_ForceSensor"
PUSHED = (THESIS_RUN, "No10_Standstill_ForceSensor_Fx", "No10_Standstill_ForceSensor_All")

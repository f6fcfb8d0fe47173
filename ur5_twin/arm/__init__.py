"""What a UR5 is: parameters, inertia, kinematics, dynamics, drives and the MJCF built from them."""

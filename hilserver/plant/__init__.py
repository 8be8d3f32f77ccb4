"""The plant: the model of the robot and its sensors."""

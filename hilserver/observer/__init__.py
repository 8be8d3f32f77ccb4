"""The observer: where the robot is, from wheels, gyro and a navigation that is late and noisy.

An extended Kalman filter over the plant's own kinematics, compiled into one step. `layout` names
its numbers, `motion` predicts, `sensors` is the measurement model, `correction` applies a sample,
and `filter` does all of it in the order of time. `figures` has the noise, `consider` the
uncertainty of the parameters. `offline` runs the filter over series, `smoother` backwards.
"""

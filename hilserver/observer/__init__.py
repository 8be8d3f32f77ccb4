"""The observer: where the robot is, from wheels, gyro and a navigation that is late and noisy.

An extended Kalman filter over the plant's own kinematics, compiled into one step. `layout` names
its numbers, `motion` predicts, `sensors` says what a sensor shows of a state, `correction` takes a
sample in, and `filter` does all of it in the order of time. `figures` says how noisy what is,
`consider` how well the parameters are known. `offline` runs it over series, `smoother` backwards.
"""

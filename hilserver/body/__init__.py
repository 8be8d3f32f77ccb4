"""The mechatronic model: a body that stands on a floor, sees walls and can be blocked (MuJoCo).

MuJoCo moves one rigid body and computes the contacts' normal forces. Wheels, drives and tyres are
our own compiled code and share the tyre law with the planar plant. Only `engine` imports mujoco.
"""

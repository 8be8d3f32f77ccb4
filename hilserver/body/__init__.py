"""The mechatronic model: bodies that stand on a floor, see walls and can be blocked (MuJoCo).

MuJoCo moves one rigid body and finds the contacts' normal forces; wheels, drives and tyres are our
own, compiled, and share the tyre law with the planar plant. `engine` alone imports mujoco.
"""

"""Test kit: a pytest plug-in with a robot in it.

``plugin`` is loaded by pytest (nothing heavy before the first test that uses `hil`); ``hil`` is the
robot in a test; ``series`` are recorded signals and their tolerance bands.
"""

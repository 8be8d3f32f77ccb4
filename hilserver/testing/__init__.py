"""Test kit: a pytest plug-in with a robot in it.

``plugin`` is what pytest loads (nothing heavy before the first test that asks for `hil`); ``hil``
is what a test works with; ``series`` the recorded signals and their tolerance bands.
"""

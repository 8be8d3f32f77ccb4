"""Before an experiment: what a manoeuvre can show, and a better one.

``manoeuvre`` holds set-points over time, ``null_log`` what the sensors would show of them if the
model were right, ``outlook`` what a diagnosis could find in that. ``pieces`` and ``search`` build
the better manoeuvre, ``planning`` combines them, ``text`` prints the result.
"""

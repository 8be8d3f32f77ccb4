"""The experiments of the thesis's chapter 5, driven again: two models beside what was measured.

`thesis` says what each was; `drive` lets a simulated robot drive it; `models` runs the kinematic
and the mechatronic model on the wheel speeds of a recording; `gaps` compares them with what was
measured; `identification` does what section 5.2 does with its recordings; `report` shows it all.
"""

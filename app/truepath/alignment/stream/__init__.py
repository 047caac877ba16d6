"""The tracker's samples put in order: cleaned, cut, in the sequence of the rows.

What is observed of the machine is made of them in `observations`.
"""

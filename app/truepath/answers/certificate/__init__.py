"""The calibration certificate: a result for the owner of the machine, on paper.

One template makes it in every language, as HTML, and the same HTML is printed as PDF.
Its content comes from the files that it is made from: result, verification,
compensation record, and the identity that people state. What is unknown is shown as not
stated. Not here: the report of a calibration (`answers.calibration_report`).
"""

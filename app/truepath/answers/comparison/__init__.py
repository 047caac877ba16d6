"""A result compared with another result or with a direct measurement.

Both sides are converted to one convention; E_n = d / (2 √(u² + u_ref²)) (ISO/IEC 17043;
Sanders et al. 2023, section 2.3). Here: differences, their file and report. Not here: a
measurement made to test a result (`answers.verification`), changes over years
(`answers.history`).
"""

"""The report of one calibration, its files and the table of its points."""

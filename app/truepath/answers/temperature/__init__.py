"""A machine's temperature model of several calibrations, as file and report."""

"""Answers to people: one folder per kind of answer, from computation to report.

Here: what a client requests of results (a certificate, a comparison, a discovery, a
trend, a verification, …): computed, as a JSON file, as a report. Not here: the estimate
(`estimation`), its tables and `result.json` (`results`), files for controls
(`compensation`), bodies of REST (`service.api.models`).

A report computes nothing that a file does not hold as well. `*_report` and `*_sections`
turn records into views: plain dictionaries of texts, numbers and figures. Jinja2
templates (`shown`) turn views into pages; markup is in templates only, and every text
from outside is escaped. A page is one file with its style sheet and its figures inside,
right on screens light and dark and on paper.

The calibration report follows the order of ISO/TR 16907: machine and measurement, error
motions, volumetric error, residuals, limits, validation, documentation. Files state
standard uncertainties (k = 1); pages state expanded ones (k = 2) and say so. The
volumetric error is that after its best-fit rigid motion over the travel is removed: the
position of the tracker is not an error of the machine.

References: ISO 230-1 (symbols), ISO/TR 16907:2015 clauses 9 to 12 (representation,
validation and documentation of numerical compensation), JCGM 100 (GUM) and 101.
"""

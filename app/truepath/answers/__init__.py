"""How results are shown: the pages of results, plans, comparisons and discoveries.

Nothing is computed here that a file does not state as well. Python modules turn records
into views: plain dictionaries of texts, numbers and figures. Jinja2 templates turn
views into pages; markup stands in templates only, and every text from outside is
escaped. A page is one file with its style sheet and its figures inside, right on
screens light and dark and on paper.

    calibration_report    the report of a result, a section a template
    discovery_report      which effects a model lacks, and the lines that would decide
    comparison_report     a result against a direct measurement
    plan_report           a plan: what it determines, and in what time
    error_sections, measurement_sections    views of the calibration report
    templating            the environment of the templates
    svg, chart            shapes, scales and frames of figures
    *_figures, volume_figure   one kind of report a file

The calibration report follows the order of ISO/TR 16907: machine and measurement, error
motions, volumetric error, residuals, limits, validation, documentation. Files state
standard uncertainties (k = 1); pages state expanded ones (k = 2) and say so. The
volumetric error is that after its best-fit rigid motion over the travel is removed: the
position of the tracker is not an error of the machine.

References: ISO 230-1 (symbols), ISO/TR 16907:2015 clauses 9 to 12 (representation,
validation and documentation of numerical compensation), JCGM 100 (GUM) and 101.
"""

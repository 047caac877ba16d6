"""An estimate to tables, maps and reports: the border, where mm become µm and rad µrad.

Everything here returns records, dictionaries or texts; writing them to disk is the work
of `jobs`. From one estimate come

- `error_tables`: each error motion on an equidistant grid, in the gauge of the file
  formats, which the parameters already hold: positioning and angular errors are 0 at
  the axis zero (else at the lowest position); straightness is 0 at both ends of the
  travel and its slopes are squareness. What the measured targets cannot tell has no
  table, never a column of zeros: it is named among the unobservable.
- `result_json`: the whole result, with the parameters and their covariance
  (`model_json`), so that `prediction` gives the same map from the file as from the
  estimate.
- `volumetric_error`: what they do at the tool point, before and after compensation.
- `report_html`: the report for people, in the order of ISO/TR 16907: machine and
  measurement, error motions, volumetric error, validation, documentation.

Uncertainties follow the GUM: variances are propagated through Jacobians from the one
covariance of the estimate. Files state standard uncertainties (k = 1); what people read
states expanded ones (k = 2) and says so. The volumetric error is that after its
best-fit rigid motion over the travel is removed, and so is its uncertainty: where the
tracker stands is not the machine's error (`estimation.volumetric_map`).

References: ISO 230-1 (symbols), ISO/TR 16907:2015 clauses 9 to 12 (representation,
validation and documentation of numerical compensation), JCGM 100 (GUM) and 101.
"""

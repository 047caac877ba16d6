"""What is stated of a machine: from Runs or a result file to numbers and JSON.

`analysis` takes Runs through alignment, estimation and the grade of the set-up to the
findings; `result_json` states them. From a result file alone come error tables,
predictions at any points, comparisons with a direct measurement, and what differs
between two models.

Every number has a unit and a standard uncertainty (k = 1). Reports show expanded
uncertainties (k = 2); `number_format` writes them at two significant digits.

The volumetric error is δ(q) = actual − nominal tool point. The uncertainty of a
prediction is that of the map without its best-fit rigid motion over the travel: a rigid
motion is a matter of convention and has no uncertainty. Tables hold for the measured
target offsets, and for any tool if all six motions of every axis are known.

Linear propagation C_y = J C Jᵀ is checked by adaptive Monte Carlo trials where asked
(`trial_results`). A comparison brings both sides into one convention and states
E_n = d / (2 √(u² + u_ref²)).

References: ISO 230-1:2012; JCGM 101:2008 (trials, clauses 7.9.4 and 8); ISO/IEC 17043
(E_n); Sanders et al. 2023, section 2.3 (comparison with direct measurements).
"""

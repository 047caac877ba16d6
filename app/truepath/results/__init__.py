"""Results of an estimate: error tables, prediction, verdict, `result.json`.

Here: numbers of one result. Not here: answers that compare, test or show results
(`answers`), files for controls (`compensation`).

`analysis` takes Runs through alignment, estimation and the grade of the set-up to the
findings; `result_json` writes them. From a result file alone come error tables and
predictions at any points.

Every number has a unit and a standard uncertainty (k = 1). Reports show expanded
uncertainties (k = 2).

The volumetric error is δ(q) = actual − nominal tool point. The uncertainty of a
prediction is that of the map without its best-fit rigid motion over the travel: a rigid
motion is a matter of convention and has no uncertainty. Tables hold for the measured
target offsets, and for any tool if all six motions of every axis are known.

Linear propagation C_y = J C Jᵀ is checked by adaptive Monte Carlo trials on request
(`monte_carlo_results`).

References: ISO 230-1:2012; JCGM 101:2008 (trials, clauses 7.9.4 and 8).
"""

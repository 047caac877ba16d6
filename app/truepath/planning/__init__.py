"""Plans: points, lines, feeds, extra lines, and the grade of a set-up.

Here: decisions before motion, by expected uncertainty. Not here: which motion is
allowed, and how long it takes (`motion`); a plan as a document (`answers.plan_report`).

One criterion holds for all: the integrated variance J = tr(G C) of the volumetric error
over the travel (brunn-hanebeck-2005, eq. 24–26, 34–36), with C the covariance of the
model's θ and G its Gram matrix, θᵀ G θ the mean square of the error. A measurement with
rows H, in units of its noise, lowers J by

    tr(S⁻¹ H C G C Hᵀ),    S = I + H C Hᵀ    (eq. 22–23, 32–33),

and adds Hᵀ H to the information C⁻¹. A line gives the two directions across it and,
less an unknown phase and speed, the one along it (sanders-2023 uses the former alone);
a standstill gives all three. Stops are chosen one after another by the drop of J per
second; then each is moved where that lowers J · T, which is invariant under repetition
of a measurement (exchange algorithm: Fedorov 1972). On one axis the best position is
exact, a root of a polynomial (eq. 27).

    design_state          present information, and that of lines or standstills
    initial_design        the state before the first leg, from the estimator's own prior
    planner               stops within a time and limits, from where the machine is
    target_blocks         the same for several targets, one after another
    default_path          the lines without a plan
    next_configuration    the paper's own question: the best point to measure next
    stations              the best tracker station
    plan, adaptive_plan   a plan for a time or a target; the next part on the way
    simulated_cells       the cells that a command would give, before anything moves
    forecast              the uncertainty after a plan, by the estimator
    grade                 one number for a set-up
    line_suggestions      the line that would help it most
"""

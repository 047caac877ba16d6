"""What to measure next: points, lines, feeds, extra lines, and the grade of a set-up.

Here: what is decided before motion by expected uncertainty. Not here: which motion is
allowed, and how long it takes (`motion`); the document of a plan (`answers.plan`).

One criterion holds for all: the integrated variance J = tr(G C) of the volumetric error
over the travel (brunn-hanebeck-2005, eq. 24–26, 34–36), with C the covariance of the
model's θ and G its Gram matrix, θᵀ G θ the mean square of the error. A measurement with
rows H, in units of its noise, lowers J by

    tr(S⁻¹ H C G C Hᵀ),    S = I + H C Hᵀ    (eq. 22–23, 32–33),

and adds Hᵀ H to the information C⁻¹. A line gives the two directions across it and,
less an unknown phase and speed, the one along it (sanders-2023 uses the former alone);
a standstill gives all three. Stops are chosen one after another by the drop of J a
second; then each is moved where that lowers J · T, which repeating a measurement leaves
as it is (exchange algorithm: Fedorov 1972). On one axis the best place is exact, a root
of a polynomial (eq. 27).

    design_state          what is known, and what lines or standstills add
    initial_design        the state before the first leg, from the estimator's own prior
    lines                 stops within a time and limits, from where the machine is
    points                the paper's own question: the best place to measure next
    stations              where the tracker is best put
    plan, adaptive_plan   a plan for a time or a target; the next part on the way
    predicted_cells       the cells that a command would give, before anything moves
    forecast              the uncertainty that a plan leaves, by the estimator
    grade, remedies       one number for a set-up, and the line that would help it most
"""

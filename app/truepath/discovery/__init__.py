"""Effects missing in the model: where it deviates, their names and evidence.

Here: search, evidence, names, open questions. Not here: the effects themselves
(`kinematics.effects`), documents and report of a discovery (`answers.discovery`).

Runs are compared with a baseline (`estimation.noise.baseline`): the rigid-body model
fitted to them, or a reference model. Each further effect is a term that is linear in
its parameters; leads, time constants and event times are scanned, then refined.

Evidence. Machine, poses, the timing of each line and the tracker's systematic errors
are integrated out first, so that a displacement that these can absorb is no evidence. A
term of information S, data r and prior covariance D then has the log Bayes factor ½ rᵀ
(S + D⁻¹)⁻¹ r − ½ log det (I + D S) (Kass & Raftery 1995), less the log of the number of
alternatives that were tried.

Search. Terms are added one by one, exchanged and removed. Each needs a log Bayes factor
of 8, and whole lines held out of the fit must be predicted better. The noise is then
fitted again together with the terms, and the search repeated. Structure without a
physical cause (waves, errors of two axes) competes with the causes, and gives way to
them.

Result. Parameters with their uncertainty, the effects that explain the Runs as well,
and the gap on held-out lines before and after. Undecided questions go to
`discrimination`, which designs lines to decide them; old and new Runs are then
explained together, each with separate pose, timing and noise.

Modules in the order of the data: line_blocks, term_equations, evidence, scan,
value_refinement, term_search, findings, residual_location, discover, open_questions.

brunn-hanebeck-2005 leaves non-rigid behaviour to future work, and sanders-2023 the
content of its residuals.
"""

"""From observations to error motions with their uncertainty.

Here: the estimate and its contradictions. Not here: observations (`alignment`), effects
(`kinematics`), tables and verdict (`results`), missing effects (`discovery`).

Measured minus nominal is linear in the parameters of machine, pose and timing. The rows
of this problem are built in one place (`design_matrix`), whitened by the noise
(`noise`) and summed to normal equations (`normal_equations`). Timing belongs to one
line and the pose to one Run: both are integrated out (`information`), so information on
the machine adds over lines and Runs (`normal_equations`; brunn-hanebeck-2005, eq.
31–33). Cells may be added one by one while the machine moves (`normal_equations`,
`live`): the sums equal those of the batch to rounding.

The prior is the bending energy of an elastic beam (`prior`; eq. 12–13). Its precisions
maximise the evidence (MacKay 1992), as do the parameters of the noise (`noise_evidence`
and `noise_fit`: restricted maximum likelihood with average information; Gilmour,
Thompson & Cullis 1995). Whether the direction of approach matters is also decided by
the evidence (`direction`). Uncertain precisions widen the covariance (Kass & Steffey
1989); Monte Carlo trials check the linear law (`monte_carlo`; GUM Supplement 1).

What no measurement of this kind determines is named, never hidden by a pseudo-inverse
(`observability`). Beyond the measured range of an axis the prior softens
(`extrapolation`). `batch` combines all of this for closed Runs, `baseline` for
discovery.

Errors that change between Runs, as a machine warms, are states over time (`drift`): two
that settle, a random walk, and terms that follow temperatures. Each Run determines them
in terms common to all.
"""

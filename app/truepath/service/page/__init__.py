"""The operator page; no science, no decisions.

Its words are in `static/locales`, its views in `static/js/views`. Reports and the
certificate are pages of their own (`answers`).

A Jinja2 shell and plain ES modules that talk to nothing but the REST interface of the
same service. The task runs Connect, Plan, Check, Run, Result, with one button that
leads on and says why it cannot. Rules of the page:

- Abort needs no other script, no event stream and no job id: `static/js/abort.js`
  stands alone, and without any script the button is a form that posts the same.
- Starting and resuming motion is held for 1.5 s; stopping is one touch.
- What is older than 2.5 s is stamped stale and greyed.
- Grey where all is well; yellow is held, red needs a person; a word and a shape with
  every colour (ISA-101, WCAG 2.2).
- Stored values are metric; mm/inch changes what is shown. Expanded uncertainties on the
  page are k = 2 and say so; files carry k = 1.
- Nothing comes from outside the service: fonts and libraries lie in `static/vendor`,
  plotly.js in the wheel of plotly.
"""

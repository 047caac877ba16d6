"""The operator page; no science, no decisions.

Its texts are in `static/locales`, its views in `static/js/views`. Reports and the
certificate are separate pages (`answers`).

A Jinja2 shell and plain ES modules that use only the REST interface of the same
service. The task runs Connect, Plan, Check, Run, Result, with one button that leads on
and gives the reason when disabled. Rules of the page:
- Abort needs no other script, no event stream and no job id: `static/js/abort.js` is
  self-contained, and without any script the button is a form that posts the same.
- Starting and resuming motion is held for 1.5 s; stopping is one touch.
- Data older than 2.5 s are stamped stale and greyed.
- Grey is normal; yellow is held, red needs an operator; a word and a shape with every
  colour (ISA-101, WCAG 2.2).
- Stored values are metric; mm/inch changes the display. Expanded uncertainties on the
  page are k = 2 and labelled so; files carry k = 1.
- Nothing comes from outside the service: fonts and libraries are in `static/vendor`,
  plotly.js in the wheel of plotly.
"""

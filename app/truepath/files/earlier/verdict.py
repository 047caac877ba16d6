"""Whether a result may be used, and for which reasons.

A reason is a kind and the values in its sentence, so that it can be written in any
language. The unit of a value is in its name, as everywhere in files.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

from truepath.errors import NotUsable

State = Literal["usable", "doubtful", "not-usable"]
STATES: tuple[State, ...] = ("usable", "doubtful", "not-usable")  # from best to worst
TITLES: Mapping[State, str] = {
    "usable": "Usable",
    "doubtful": "Doubtful",
    "not-usable": "Not to be used",
}
Value = int | float | str


class Sentence(NamedTuple):
    """Sentence of a kind of reason, `{name}` for a value, and its remedy."""

    text: str
    remedy: str


STATED = "stated"
SENTENCES: Mapping[str, Sentence] = {
    "samples-left-out": Sentence(
        "{samples} samples of line {line}, from {from_s} to {to_s} on the tracker's "
        "clock, are left out: they lie {distance_um} aside from the others.",
        "Look at what crossed the beam or moved the reflector at that time; on the "
        "first line of a Run, lost motion that was not taken up yet looks the same.",
    ),
    "spikes-left-out": Sentence(
        "{samples} lone samples are left out: they lie up to {distance_um} aside.",
        "Look at the tracker's lock and its cables where there are many.",
    ),
    "stream-astray": Sentence(
        "From {from_s} to {to_s} on the tracker's clock, from line {line} on, the "
        "reflector is up to {distance_um} off the path; data of that time are not "
        "used.",
        "Look whether tracker or reflector was moved by more than a millimetre at that "
        "time, or the frame, a sign or a unit of the stream changed.",
    ),
    "air-uncorrected": Sentence(
        "The tracker's ranges are not corrected for the air: {why}. The scale of "
        "all lengths and positioning deviations is uncertain by up to 270 µm/m.",
        "Measure temperature and pressure of the air, and measure again.",
    ),
    "air-assumed": Sentence(
        "Typical air is assumed in place of measured values: {why}. The scale of "
        "all lengths is known to {within_um} per metre (k = 2); this is included in"
        " U.",
        "Measure temperature and pressure of the air, enter the site's altitude, or"
        " measure a known length with the tracker.",
    ),
    "sensor-left-out": Sentence(
        "Readings of a sensor are not believed, and not used: {what}.",
        "Look at its wires, register, order of words and unit; state the site's "
        "altitude where it is a pressure.",
    ),
    "range-off": Sentence(
        "All distances of the tracker seem to be off by {distance_um} (within "
        "{within_um}, k = 2): a wrong home distance or constant of the reflector. The "
        "errors stated are wrong by about a fifteenth of it.",
        "Set the home distance again, choose the reflector in use, measure again; a "
        "discovery takes it out of this Run.",
    ),
    "all-axes-scaled": Sentence(
        "All linear axes are off by {distance_um} a metre alike (within {within_um}, "
        "k = 2): by the pressure or temperature of the air that the tracker takes, by "
        "its scale, or by a machine that is warmer or colder than its scales say.",
        "Check the air values of the tracker and the temperature of the machine; "
        "measure a known length with the tracker.",
    ),
    "scale-known": Sentence(
        "Known lengths ({lengths}) say that all distances of the tracker were off "
        "by {distance_um} in a metre (within {within_um}, k = 2): the result is "
        "without that.",
        "Look at what the tracker takes for the air, where it is more than the air "
        "can be.",
    ),
    "machine-scaled": Sentence(
        "All linear axes are off by {distance_um} a metre alike (within "
        "{within_um}, k = 2), by the machine: the known lengths have settled the "
        "tracker's scale and its air.",
        "Look at the temperature of the machine, and at the known lengths where "
        "those say that the tracker was far off as well.",
    ),
    "lines-without-data": Sentence(
        "No stretch at constant feed was found on lines {lines}: they were not "
        "measured, too short, or disturbed.",
        "Look at what happened on these lines; measure them again.",
    ),
    "points-without-data": Sentence(
        "No standstill was recognised at points {points}: the tracker did not see the "
        "target, or it was not where it should be.",
        "Look at what happened at these points; measure them again.",
    ),
    "path-not-whole": Sentence(
        "The recording shows lines {first} to {last}; the last of the path is {lines}.",
        "Let the program run to its end, and record from before its start until after.",
    ),
    "path-cut-short": Sentence(
        "The reflector is at rest {before} times before the first row of the path "
        "and {after} times after its last: rows are missing there, or more was "
        "recorded.",
        "Give the complete path; only its rows are used.",
    ),
    "chain-other": Sentence(
        "The data fit {other} {times_ratio} times better than the declared {declared}: "
        "the tables are those of a machine that is not this one.",
        "Correct kinematic_chain in the machine file, and analyse again.",
    ),
    "other-feed": Sentence(
        "Lines {lines} were measured at {lowest_percent} to {highest_percent} of "
        "the feed of the path.",
        "Set the feed override to 100 % for the next Run; the tables do not rest on "
        "it.",
    ),
    "recorded-again": Sentence(
        "The program was recorded more than once: {samples} samples, from {from_s} to"
        " {to_s} on the tracker's clock, are of another run of it and not used; "
        "{used_samples} are used.",
        "Cut the recording into one for each run of the program, and analyse them "
        "together.",
    ),
    "samples-missing": Sentence(
        "{samples} samples are missing in the recording, by their times: at {times} "
        "places, for {longest_s} at the longest.",
        "Look at the computer that recorded and at its connection to the tracker; "
        "record to the end, and export everything.",
    ),
    "clock-off": Sentence(
        "Lines and standstills alike took {took_percent} of the time that they "
        "should: the rate or the times of the recording are wrong, not the feed.",
        "Import the recording with its own times, or at the rate that the tracker had.",
    ),
    "held-on-the-way": Sentence(
        "The machine stopped in the middle of lines: {times} times, on {lines}, for"
        " {longest_s} at the longest.",
        "No data are lost; find out what held the feed.",
    ),
    "much-left-out": Sentence(
        "{left_out_percent} of the samples are left out; up to {usual_percent} is "
        "typical.",
        "Clear the line of sight, look at the lock of the tracker, measure again.",
    ),
    "fit-beyond-noise": Sentence(
        "The residual of the fit is {ratio} times that of noise; up to "
        "{limit_ratio} is typical.",
        "Let a discovery look for what the model lacks, or measure again.",
    ),
    "noise-beyond-stated": Sentence(
        "Samples scatter {ratio} times as much as specified for the tracker in the "
        "machine file; up to {limit_ratio} is typical.",
        "Correct the tracker's noise in the machine file, or look for vibration and"
        " turbulent air.",
    ),
    "places-differ": Sentence(
        "What the tracker says of one place differs from the next by {range_um} along "
        "the range, {azimuth_um} in azimuth and {elevation_um} in elevation (1 σ): "
        "{ratio} times the noise of a sample that the machine file states. It is in "
        "the uncertainty.",
        "Look for air, vibration or a loose mount; state the tracker's noise as it is.",
    ),
    "loop-open": Sentence(
        "Points that were measured early and late differ by {distance_um}; up to "
        "{limit_um} is typical.",
        "Let tracker and machine warm up, fasten tracker and reflector, measure again.",
    ),
    "set-up-moved": Sentence(
        "Tracker or reflector moved by {distance_um} at {at_s}; the Run is split there "
        "and solved with both places.",
        "Fasten tracker and reflector, and measure again where it matters.",
    ),
    "tracker-tilted": Sentence(
        "The tracker tilted by {angle_urad} at {at_s}; the Run is split there and "
        "solved with both poses.",
        "Fasten the tracker and its stand, let the stand settle, and measure again "
        "where it matters.",
    ),
    "range-offset-changed": Sentence(
        "The range offset of the tracker changed by {distance_um} at {at_s}, by a new "
        "lock of its beam or another reflector; it is solved for.",
        "Set the home distance after every loss of the beam; keep the line of sight "
        "free.",
    ),
    "knock-unseen": Sentence(
        "Data are left out at rows {rows}, and no earlier point is measured again "
        "after: an unintended shift of tracker or reflector there is not "
        "detectable.",
        "Fasten tracker and reflector; measure again, the first reflector once more"
        " at the end.",
    ),
    "not-measured-again": Sentence(
        "Too few earlier points are measured again after rows {rows}: an unintended"
        " shift of tracker or reflector there is not detectable.",
        "Measure the first reflector once more at the end, as plans do.",
    ),
    "ramps-swing": Sentence(
        "The machine swings while it accelerates: a stretch of a ramp counts as if it "
        "were off by {distance_um}.",
        "Use a lower feed or gentler ramps, or look for a loose mount where it should "
        "be stiff.",
    ),
    "axis-scaled": Sentence(
        "Axis {axes} moved {by} too far, more than machines do: the program may have "
        "been scaled, or be another one.",
        "Compare the program that ran with the specified one; run it without "
        "scaling. If they agree, correct the scale of the axis.",
    ),
    "axes-leaning": Sentence(
        "Axes {axes} are off square by {by}, more than machines are: the program may "
        "have been changed, or be another one.",
        "Compare the program that ran with the specified one. If they agree, align "
        "the machine.",
    ),
    "axis-shifted": Sentence(
        "Axis {axes} is {by} off its place against the rotary axes, more than machines "
        "are: a work offset was in use, or the machine file places its axes elsewhere.",
        "Run the program without offsets; compare origin_mm, offset_mm and zero points "
        "with the machine.",
    ),
    "little-gained": Sentence(
        "The mean error found is {found_um}; {left_um} is expected to remain after "
        "compensation.",
        "Measure more lines, or from a nearer station; or use the machine as it is.",
    ),
    "lines-off": Sentence(
        "The newest lines or points ({lines}) do not fit what came before and are left "
        "out: they lie up to {distance_um} aside.",
        "Look at tracker and reflector; the next lines show whether these have moved.",
    ),
    "model-in-use": Sentence(
        "It rests on the model {model}, which is doubtful itself.",
        "Look at the reasons of the model; make it again from a Run that is usable.",
    ),
    STATED: Sentence("{text}", ""),
}
"""Every kind of reason; the operator page says the same kinds in its languages."""

_NAMED = 3  # reasons in one line

# Decimals and sign of a value by the last word of its name.
# Rows, and the lines that lead to them: values count them from 0, sentences from 1.
_COUNTED = frozenset({"line", "lines", "points", "rows", "first", "last"})
_SHOWN = {
    "s": (1, " s"),
    "um": (1, " µm"),
    "urad": (1, " µrad"),
    "mm": (2, " mm"),
    "percent": (1, " %"),
    "ratio": (2, ""),
}


@dataclass(frozen=True, slots=True)
class Reason:
    """One objection or notice on a result.

    kind : one of `SENTENCES`
    state : the best that a result with this reason may have
    values : of the sentence
    run : name of the Run that it is about, where there are several
    """

    kind: str
    state: State
    values: Mapping[str, Value]
    run: str = ""

    def __str__(self) -> str:
        text = SENTENCES[self.kind].text.format(**self.shown)
        return f"Run {self.run}: {text}" if self.run else text

    @property
    def shown(self) -> dict[str, str]:
        """Values of the sentence, with units; rows from 1."""
        return {name: _format_value(name, value) for name, value in self.values.items()}

    @property
    def severity(self) -> int:
        """0 where a result with this reason may be used, 2 where it may not."""
        return STATES.index(self.state)

    @property
    def remedy(self) -> str:
        """What the operator can do; may be empty."""
        return SENTENCES[self.kind].remedy


@dataclass(frozen=True, slots=True)
class Verdict:
    """Whether a result may be used.

    reasons : a usable result has some as well, where data were left out
    """

    reasons: tuple[Reason, ...] = ()

    @property
    def state(self) -> State:
        """The worst state of any reason."""
        return STATES[max((reason.severity for reason in self.reasons), default=0)]

    @property
    def title(self) -> str:
        """English title of the state."""
        return TITLES[self.state]

    @property
    def objection(self) -> str:
        """Why it is not simply usable, in one line; empty where it is."""
        if self.state == "usable":
            return ""
        grave = [str(reason) for reason in self.reasons if reason.severity]
        more = [f"And {len(grave) - _NAMED} more."] if len(grave) > _NAMED else []
        return f"{self.title.lower()}: {' '.join(grave[:_NAMED] + more)}"

    def rank(self) -> Iterator[tuple[Reason, str]]:
        """Reasons, the worst first, each kind's remedy with its first."""
        told: set[str] = set()
        for reason in sorted(self.reasons, key=lambda reason: -reason.severity):
            yield reason, "" if reason.kind in told else reason.remedy
            told.add(reason.kind)

    def require_usable(self, what: str) -> None:
        """Raise NotUsable if it is not to be used; `what` names the result."""
        if self.state == "not-usable":
            raise NotUsable(f"{what} is {self.objection}")

    @staticmethod
    def merge(verdicts: Iterable[Verdict]) -> Verdict:
        """With the reasons of all."""
        return Verdict(tuple(reason for v in verdicts for reason in v.reasons))


def verdict_from_json(content: Mapping[str, Any]) -> Verdict:
    """From the key `verdict` of a file.

    A file may be of another version, or written by hand: where its reasons cannot be
    written again, or do not imply its state, its sentences are kept as they are.
    """
    state, texts = content["state"], list(content["reasons"])
    restored = _restore(content.get("details"))
    said = [_format_reason(reason) for reason in restored.reasons]
    if said == texts and restored.state == state:
        return restored
    texts = texts or ["The file states no reason."]
    return Verdict(tuple(Reason(STATED, state, {"text": text}) for text in texts))


def verdict_json(verdict: Verdict) -> dict[str, Any]:
    """Content of the key `verdict`: state, sentences, and their values."""
    return {
        "state": verdict.state,
        "reasons": [str(reason) for reason in verdict.reasons],
        "details": [
            {
                "kind": reason.kind,
                "state": reason.state,
                "run": reason.run,
                "values": dict(reason.values),
                "remedy": reason.remedy,
            }
            for reason in verdict.reasons
        ],
    }


def _restore(details: Any) -> Verdict:
    names = "kind", "state", "values", "run"
    try:
        given = [{name: detail[name] for name in names} for detail in details or ()]
        reasons = tuple(Reason(**each) for each in given)
    except (KeyError, TypeError):
        return Verdict()
    return Verdict(tuple(r for r in reasons if r.state in STATES))


def _format_reason(reason: Reason) -> str | None:
    try:
        return str(reason)
    except (AttributeError, KeyError, TypeError, ValueError):
        return None


def _format_value(name: str, value: Value) -> str:
    if name in _COUNTED:
        return re.sub(r"\d+", lambda number: str(int(number[0]) + 1), str(value))
    if isinstance(value, str):
        return value
    usual = 0 if isinstance(value, int) else 2
    decimals, sign = _SHOWN.get(name.rsplit("_", 1)[-1], (usual, ""))
    return f"{value:.{decimals}f}{sign}"

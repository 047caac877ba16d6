/* What the service says in English of a fault or a refusal, in the language of the page. */
import { known, number, t } from "./texts.js";

const N = "[\\d.]+";
/** Sentences of the service by the key of what the page says instead; groups are its values. */
const SENTENCES = Object.entries({
  "interrupted.in_state": /^the service ended while the job was (?<state>[a-z-]+)$/,
  "interrupted.under_way": /^the service was ended while the job was under way$/,
  "given-up.times": /^the service ended (?<count>\d+) times while the job was computing/,
  "illegal-transition.in_state": /^cannot [a-z-]+ a job that is (?<state>[a-z-]+); only/,
  "illegal-transition.still": /^cannot pause a job that is [a-z-]+: nothing moves any more$/,
  "illegal-transition.over": /^cannot [a-z-]+ a job that is not under way any more$/,
  "busy.in_state": /^job \S+ \((?<state>[a-z-]+)\) holds the machine$/,
  "tracker-silent.held": /^no sample has come for half a second; the feed is held$/,
  "tracker-silent.for": RegExp(`^no sample has come for (?<seconds>${N}) s$`),
  "points-only.path": /^this tracker measures standing targets, point by point, and the plan is a path$/,
  "no-times.path": /^the tracker's samples bear the time of their arrival, and the plan is a path/,
  "stream-damaged.held": RegExp(`^more than (?<share>${N}) % of the tracker's samples are bad or lost; the feed is held$`),
  "stream-damaged.stays": /^too many of the tracker's samples stay bad or lost$/,
  "stop-unconfirmed.moves": /^the machine moves on although the rest of its path was called off$/,
  "stop-unconfirmed.told": /^the controller was told to stop and does not say that it stands$/,
  "hold-unconfirmed.moves": RegExp(`^the machine moves (?<seconds>${N}) s after a hold$`),
  "resume-unconfirmed.holds": /^the controller keeps holding$/,
  "not-moving.while": /^the machine says that it runs, and has not moved for a while$/,
  "feed-override.stands": /^the feed override is 0 %: the machine says that it runs, and stands$/,
  "feed-override.other": RegExp(`^the feed override is (?<percent>${N}) %: feeds are not those of the plan$`),
  "motion-busy.program": /^the controller runs a program, or somebody holds one at the panel$/,
  "wrong-target.beside": RegExp(`^the point is not that of target (?<name>.+?): it lies (?<mm>${N}) mm from`),
  "ended-early.elsewhere": /^the controller is \S+ at (?<here>.+) \(row (?<row>\d+)\), not at (?<there>.+)$/,
  "runs-on.to": /^the machine has moved on from the end of its path to (?<here>.+); the controller says/,
  "closure.moved": RegExp(`^the target is (?<um>${N}) µm from where it was measured before the interruption, (?<allowed>${N}) µm are allowed`),
  "disk-stays-slow_text": /^the disk has not caught up within 10 s; the feed stays held$/,
  "sensor-no-number.of": /^(?<name>\S+): it shows no number$/,
  "sensor-implausible.of": /^(?<name>\S+): (?<value>\S+) (?<unit>.+) is not within (?<low>\S+) to (?<high>\S+)$/,
  "sensor-implausible.site": /^(?<name>\S+): (?<value>\S+) hPa is not within (?<low>\S+) to (?<high>\S+), of a site at (?<altitude>\S+) m$/,
  "sensor-implausible.low_site": /^(?<name>\S+): (?<value>\S+) hPa is not within (?<low>\S+) to (?<high>\S+), of a site whose/,
  "sensor-implausible.tiny": /^(?<name>\S+): (?<value>\S+) \S+ is nearly 0, as of words in the wrong order/,
  "sensor-implausible.zero": /^(?<name>\S+): 0 \S+ to the last digit, as of a register/,
  "sensor-implausible.step": /^(?<name>\S+): (?<value>\S+) (?<unit>\S+) comes (?<seconds>\S+) s after (?<last>\S+) \S+$/,
  "sensor-implausible.apart": /^(?<name>\S+): (?<value>\S+) \S+ is (?<apart>\S+) K from all others$/,
  "sensor-stuck.of": RegExp(`^(?<name>\\S+): it has shown (?<value>\\S+) unchanged for (?<seconds>${N}) s$`),
  "sensor-back.of": /^(?<name>\S+) shows readings again$/,
  "motion-alarm.said": /^the controller is in alarm(?:: (?<said>.+))?$/,
  "motion-not-ready.said": /^the drives are off(?:: (?<said>.+))?$/,
  "motion-unhomed.said": /^the machine is not homed(?:: (?<said>.+))?$/,
  "motion-estop.said": /^the emergency stop is active(?:: (?<said>.+))?$/,
  "motion-door.said": /^a door is open(?:: (?<said>.+))?$/,
});

/** What is said of a code; null where the service's own sentence has to stand, empty where its title says it all. */
export function sayFault(code, detail) {
  const [key, found] = SENTENCES.filter(([key]) => key.split(/[._]/)[0] === code)
    .map(([key, pattern]) => [key, pattern.exec(detail)]).find(([, found]) => found) ?? [];
  if (!found) return null;
  if (key.endsWith(".said")) return found.groups.said ? t("problem.code.motion-alarm.said", found.groups) : "";
  return t(`problem.code.${key}`, wordValues(found.groups ?? {}));
}

/** Numbers as the language writes them, states in its words. */
function wordValues(groups) {
  return Object.fromEntries(Object.entries(groups).map(([name, value]) => [name, wordOf(name, value)]));
}

function wordOf(name, value) {
  if (name === "state") return known(`state.${value}`, value);
  if (name === "name") return known(`sensor.${value.replace(/_degC$/, "")}`, value);
  return value.replaceAll(", ", "; ").replace(/-?\d+(?:\.(\d+))?/g, (digits, decimals = "") => number(digits, decimals.length));
}

/* Of several stations: where the tracker goes, and why a station was asked for again. */
import { waitsForArming } from "../flow.js";
import { notice } from "../parts.js";
import { number, t } from "../texts.js";
import { quantity } from "../units.js";

const AXES = ["X", "Y", "Z"];
const REASONS = {
  "not-moved": "station.not-moved", "not-seen": "station.not-seen", residual: "station.residual",
};

/** What a person has to do with the tracker before the job is armed, as notices. */
export function stationNotices(job) {
  const { station } = job;
  if (!station || !waitsForArming(job)) return [];
  const check = station.checks.find((one) => one.station === station.number);
  const place = AXES.map((name, i) => `${name} ${quantity(station.position_mm[i], "travel")}`);
  const values = { number: number(station.number), total: number(station.total), place: place.join(", ") };
  const asked = notice("held", t("station.title", values), t("station.text", values), t("station.action"));
  return check?.problem ? [refused(check), asked] : [asked];
}

function refused({ problem, text }) {
  return notice("fault", t(REASONS[problem]), text, t("station.again"));
}

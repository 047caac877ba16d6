/* Of several stations: where the tracker goes, and why a station was asked for again. */
import { waitsForArming } from "../flow.js";
import { notice } from "../parts.js";
import { number, t } from "../texts.js";
import { placeText } from "./advice-card.js";

const REASONS = {
  "not-moved": "station.not-moved", "not-seen": "station.not-seen", residual: "station.residual",
  moved: "station.moved",
};

/** What a person has to do with the tracker before the job is armed, as notices. */
export function stationNotices(job) {
  const { station } = job;
  if (!station || !waitsForArming(job)) return [];
  const check = station.checks.find((one) => one.station === station.number);
  const place = placeText(station.position_mm);
  const values = { number: number(station.number), total: number(station.total), place };
  const asked = notice("held", t("station.title", values), t("station.text", values), t("station.action"));
  return check?.problem ? [refused(check), asked] : [asked];
}

function refused({ problem, text }) {
  return notice("fault", t(REASONS[problem]), text, t("station.again"));
}

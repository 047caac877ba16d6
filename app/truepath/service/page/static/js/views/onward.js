/* Where the one button leads from a result: on to what is done with it. */
import { reach } from "../flow.js";
import { t } from "../texts.js";

const NEXT = { discover: "export", export: "verify", verify: "certificate" };

/** The button that leads from a step to the next; to a new measurement where nothing follows. */
export function onward(step, state, go) {
  const target = step === "result" ? afterResult(state) : NEXT[step];
  const address = target && reach(target, state);
  if (!address) return { key: "measure", ...newMeasurement(go) };
  return { key: target, label: t(`onward.${target}`), run: () => go(address) };
}

/** A new measurement, which stays available beside what comes next. */
export const newMeasurement = (go) => ({ label: t("result.next"), run: () => go("#/connect") });

/** A fit that is worse than its noise asks what the model lacks before anything is corrected with it. */
function afterResult({ job, result }) {
  const { state, details = [] } = result?.verdict ?? {};
  const lacks = state === "not-usable" || details.some(({ kind }) => kind === "fit-beyond-noise");
  return lacks && job?.run_id ? "discover" : "export";
}

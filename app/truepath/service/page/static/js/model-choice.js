/* The model that the next plan, measurement and analysis on this panel use: of one machine. */
import { preference, prefer } from "./preferences.js";

const TAKES_MODEL = new Set(["measure-otf", "measure-standstill", "measure-adaptive", "analyse"]);

/** Id of the model that is used for a machine; null where none is. */
export function modelInUse(machine) {
  const { id, name } = JSON.parse(preference("model"));
  return id && name === machine?.name ? id : null;
}

/** Use a model from now on, or none: `id` null. */
export const useModel = (id, machine) => prefer("model", JSON.stringify({ id, name: machine?.name ?? null }));

/** A job's order, or a plan's request, with the model where it takes one. */
export function withModel(order, machine) {
  const id = modelInUse(machine);
  const takes = order.kind === undefined || (TAKES_MODEL.has(order.kind) && !order.continues);
  return id && takes && order.model_id === undefined ? { ...order, model_id: id } : order;
}

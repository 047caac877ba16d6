/* Keep-out boxes of each machine, as this panel keeps them: axis positions X, Y, Z that no motion may touch. */
import { prefer, preference } from "./preferences.js";
import { number, t } from "./texts.js";

export const LINEAR = ["X", "Y", "Z"];
const MOST_MM = 1e6;

/** Boxes of a machine: [{name, min_mm, max_mm}, …]; an end that is not typed yet is null. */
export const boxesOf = (machine_id) => all()[machine_id] ?? [];

/** Keep them; they outlast a reload, since a box that is forgotten is driven through. */
export const keepBoxes = (machine_id, boxes) => prefer("keep_out", JSON.stringify({ ...all(), [machine_id]: boxes }));

const all = () => JSON.parse(preference("keep_out"));

/** Whether an end of a box along X, Y or Z may be sent. */
export const isEnd = (value_mm) => Number.isFinite(value_mm) && Math.abs(value_mm) <= MOST_MM;

/** Whether a box has all its ends along an axis, the lower one first. */
export const isWholeAlong = ({ min_mm, max_mm }, axis) => isEnd(min_mm[axis]) && isEnd(max_mm[axis]) && min_mm[axis] < max_mm[axis];

/** Whether boxes can be sent as they are. */
export const areWhole = (boxes) => boxes.every((box) => LINEAR.every((_, axis) => isWholeAlong(box, axis)));

/** What a box is called: by its name, else by its number. */
export const nameOfBox = ({ name }, at) => name?.trim() || t("keepout.box", { number: number(at + 1) });

/** Boxes as the service takes them. */
export const orderBoxes = (boxes) => boxes.map(({ name, min_mm, max_mm }) => ({ ...(name.trim() ? { name: name.trim() } : {}), min_mm, max_mm }));

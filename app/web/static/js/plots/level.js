/* A dashed line across a chart: a target, or a limit. */
import { colour } from "./colours.js";

/** Draw it at a value of the scale y; nothing where it is null. */
export function drawLevel(chart, value) {
  if (value === null) return;
  const y = Math.round(chart.valToPos(value, "y", true)) + 0.5;
  const { left, width } = chart.bbox;
  chart.ctx.save();
  chart.ctx.strokeStyle = colour("text");
  chart.ctx.lineWidth = 1.5 * devicePixelRatio;
  chart.ctx.setLineDash([7 * devicePixelRatio, 5 * devicePixelRatio]);
  chart.ctx.beginPath();
  chart.ctx.moveTo(left, y);
  chart.ctx.lineTo(left + width, y);
  chart.ctx.stroke();
  chart.ctx.restore();
}

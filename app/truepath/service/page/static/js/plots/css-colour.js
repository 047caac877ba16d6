/* Colours of the style sheet for what is drawn on canvases. */

/** Value of a custom property as it is now, light or dark. */
export function colour(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
}

/** Font of canvases. */
export const font = (size_px, weight = 450) => `${weight} ${size_px}px Inter, sans-serif`;

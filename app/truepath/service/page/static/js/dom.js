/* Elements from calls: h("p", {class: "quiet"}, "text", child). */
const SVG = "http://www.w3.org/2000/svg";
const ICONS = new URL("../icons.svg", import.meta.url).pathname;

/** Make an element; `on…` are listeners, `null`, `false` and `undefined` are left out; a button submits only where it says so. */
export function h(tag, attributes = {}, ...children) {
  return fill(document.createElement(tag), tag === "button" ? { type: "button", ...attributes } : attributes, children);
}

/** The same for SVG. */
export function s(tag, attributes = {}, ...children) {
  return fill(document.createElementNS(SVG, tag), attributes, children);
}

/** A picture of static/icons.svg. */
export function icon(name) {
  return s("svg", { "aria-hidden": "true" }, s("use", { href: `${ICONS}#${name}` }));
}

/** Set an element's text only if it differs, so that screen readers hear changes only. */
export function write(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/** Set or remove an attribute. */
export function mark(element, name, value) {
  if (value === null || value === false || value === undefined) element.removeAttribute(name);
  else if (element.getAttribute(name) !== String(value)) element.setAttribute(name, value);
}

function fill(element, attributes, children) {
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (value === true) element.setAttribute(name, "");
    else mark(element, name, value);
  }
  element.append(...children.flat(Infinity).filter((c) => c !== null && c !== false && c !== undefined));
  return element;
}

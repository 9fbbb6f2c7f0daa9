// Keeps what is drawn where it stands while lists and tables change, and the focus with it. Must never draw a kept part anew.

import { focusOn } from "./shared/dom.js";

const FOCUSABLE = "button, a[href], input, select, [tabindex]";

/**
 * Let a place have these children, in this order. Those that stay are not moved, if their order is as before. Where one goes
 * that has the focus, its neighbour gets it, else the region around it.
 */
export function arrange(place, children) {
  const wanted = new Set(children);
  const before = [...place.children];
  const lost = before.findIndex((child) => !wanted.has(child) && child.contains(document.activeElement));
  const heir = lost < 0 ? null : [...before.slice(lost + 1), ...before.slice(0, lost).reverse()].find((child) => wanted.has(child));
  for (const child of before) if (!wanted.has(child)) child.remove();
  let next = place.firstElementChild;
  for (const child of children) {
    if (child === next) next = next.nextElementSibling;
    else place.insertBefore(child, next);
  }
  if (lost >= 0) focusIn(heir ?? place);
}

function focusIn(place) {
  const own = place.matches(FOCUSABLE) ? place : place.querySelector("input:checked") ?? place.querySelector(FOCUSABLE);
  focusOn(own ?? place.closest("[tabindex]"), { stay: true });
}

/** What is kept by key: `get(key, make)` makes what is not there, `find(key)` does not, `keep(keys)` forgets the others. */
export function createKept() {
  const parts = new Map();
  return {
    get(key, make) {
      if (!parts.has(key)) parts.set(key, make());
      return parts.get(key);
    },
    find: (key) => parts.get(key),
    keep(keys) {
      const wanted = new Set(keys);
      for (const key of [...parts.keys()]) if (!wanted.has(key)) parts.delete(key);
    },
    entries: () => parts.entries(),
  };
}

/** Write a text where another stands. */
export function write(node, text) {
  if (node.textContent !== String(text)) node.textContent = text;
}

/** Set an attribute that has another value. */
export function mark(node, name, value) {
  if (node.getAttribute(name) !== value) node.setAttribute(name, value);
}

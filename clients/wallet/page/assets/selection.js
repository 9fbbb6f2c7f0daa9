// What a person chose in a list, on its way to the form for sharing, erasing or taking along. Lives in memory alone.

let pending = null;

/** Choose: {records: [id], frames?: [index], visit?: hex, all?: bool, title: words, back: place}. */
export function choose(selection) {
  pending = selection;
}

/** What was chosen last, or null. */
export const chosen = () => pending;

let wished = null;

/** Have a meeting played as soon as it is shown: for a press of a button, never for an address. */
export function wishToWatch(visit) {
  wished = visit;
}

/** Tell, once, whether a meeting is to be played as soon as it is shown. */
export function takeWish(visit) {
  const is = wished === visit;
  wished = null;
  return is;
}

/** Forget it, once it is done. */
export function drop() {
  pending = null;
}

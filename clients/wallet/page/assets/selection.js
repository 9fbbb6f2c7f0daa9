// What a person chose in a list, on its way to the form for sharing, erasing or taking along. Lives in memory alone.

let pending = null;

/** Choose: {records: [id], frames?: [index], visit?: hex, all?: bool, title: words, back: place}. */
export function choose(selection) {
  pending = selection;
}

/** What was chosen last, or null. */
export const chosen = () => pending;

/** Forget it, once it is done. */
export function drop() {
  pending = null;
}

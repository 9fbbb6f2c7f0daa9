// Makes elements and asks questions. Never parses text as HTML: what others wrote is always shown as text.

const SVG_TAGS = new Set(["svg", "g", "path", "line", "rect", "circle", "polyline", "polygon", "text", "title", "desc", "defs", "marker", "tspan"]);
const SVG_NAMESPACE = "http://www.w3.org/2000/svg";

/** Make an element. Props: `class`, `on<event>` listeners, properties (value, checked, disabled, hidden...), attributes. */
export function h(tag, props = {}, ...children) {
  return build(document.createElement(tag), props, children);
}

/** Make an SVG element. */
export function s(tag, props = {}, ...children) {
  if (!SVG_TAGS.has(tag)) throw new Error(`not an SVG element: ${tag}`);
  return build(document.createElementNS(SVG_NAMESPACE, tag), props, children);
}

const SHOWN_ATTRIBUTES = new Set(["title", "alt", "placeholder", "aria-label", "aria-description", "aria-valuetext"]);
const PROPERTIES = new Set(["value", "checked", "disabled", "hidden", "indeterminate", "open", "readOnly", "selected"]);

function build(node, props, children) {
  for (const [name, value] of Object.entries(props ?? {})) {
    if (value === undefined || value === null || value === false) continue;
    if (name.startsWith("on") && typeof value === "function") node.addEventListener(name.slice(2).toLowerCase(), value);
    else if (PROPERTIES.has(name)) node[name] = value;
    else node.setAttribute(name === "className" ? "class" : name, value === true ? "" : SHOWN_ATTRIBUTES.has(name) ? visible(value) : String(value));
  }
  append(node, children);
  return node;
}

const CONTROLS = /(?![\n\t])[\p{Cc}\p{Cf}\p{Zl}\p{Zp}\p{Cs}]/gu;

/** Write what cannot be seen, or reorders the text around it, as an escape: others may have put it there. */
export function visible(text) {
  return String(text).replace(CONTROLS, (control) => Array.from({ length: control.length }, (_, unit) => `\\u${control.charCodeAt(unit).toString(16).padStart(4, "0")}`).join(""));
}

function append(node, children) {
  for (const child of children.flat(Infinity)) {
    if (child === undefined || child === null || child === false) continue;
    node.append(child instanceof Node ? child : document.createTextNode(visible(child)));
  }
}

/** Replace all children of a node. */
export function replace(node, ...children) {
  node.textContent = "";
  append(node, children);
  return node;
}

/** Tell whether what a button began goes on. */
export function isAtWork(button) {
  return button?.getAttribute("aria-busy") === "true";
}

/** Say that what a button began goes on, or is over. It keeps the focus, which a disabled one would lose. */
export function setAtWork(button, isNow) {
  if (isNow) button?.setAttribute("aria-busy", "true");
  else button?.removeAttribute("aria-busy");
}

const SPOKEN_MS = 3000;
let liveRegion = null;
let spoken = [];

/**
 * Say something to who listens to the page: politely, without moving the focus. What was said a moment before stays beside
 * it, or nobody would hear it; an empty text takes everything back.
 */
export function announce(text) {
  if (!liveRegion) {
    liveRegion = h("div", { class: "visually-hidden", role: "status", "aria-live": "polite", "aria-atomic": "false" });
    document.body.append(liveRegion);
  }
  const now = performance.now();
  for (const one of spoken) if (!text || now - one.at > SPOKEN_MS) one.line.remove();
  spoken = text ? [...spoken.filter((one) => now - one.at <= SPOKEN_MS), { at: now, line: h("div", {}, text) }] : [];
  setTimeout(() => { liveRegion.append(...spoken.map((one) => one.line).filter((line) => !line.isConnected)); }, 50); // a region that is new is known by then
}

let dialogCount = 0;

/**
 * Ask in a dialog; resolve to the fields' values by name ({} without fields), or to null if it was cancelled.
 * fields: [{name, label, type, hint, value, required, options: [{value, label}], autocomplete}].
 * With `attempt` the dialog stays, says `busy` and takes nothing more, until `attempt(values)` is through: it resolves to
 * {answer}, which is the dialog's, or to {refusal}, words that the dialog shows and asks again. What it throws is thrown.
 */
export function ask({ title, body = [], confirm, cancel, danger = false, fields = [], attempt = null, busy = "" }) {
  return new Promise((resolve, reject) => {
    const before = document.activeElement;
    const key = before?.closest("[data-key]")?.dataset.key;
    const id = `dialog-${(dialogCount += 1)}`;
    const inputs = fields.map((field) => [field, makeInput(field, `${id}-${field.name}`)]);
    let answer = null;
    let failure = null;
    let isBusy = false;
    const refused = h("div", { role: "alert" });
    const waits = h("p", { class: "quiet", role: "status" });
    const values = () => Object.fromEntries(inputs.map(([field, input]) => [field.name, field.type === "checkbox" ? input.checked : input.value]));
    const form = h("form", { method: "dialog", onsubmit: async (event) => {
      event.preventDefault();
      if (isBusy) return;
      if (!attempt) {
        answer = values();
        dialog.close();
        return;
      }
      setBusy(true);
      try {
        const outcome = await attempt(values());
        if (outcome.refusal === undefined) answer = outcome.answer;
        else replace(refused, h("p", { class: "notice bad" }, outcome.refusal));
        setBusy(false);
        if (outcome.refusal === undefined) dialog.close();
        else askAgain();
      } catch (error) {
        failure = error;
        setBusy(false);
        dialog.close();
      }
    } },
      h("h2", { id }, title), body, attempt && refused,
      inputs.map(([field, input]) => field.type === "checkbox"
        ? h("div", { class: "field" }, h("label", { class: "switch" }, input, field.label), field.hint && h("div", { class: "quiet", id: `${input.id}-hint` }, field.hint))
        : h("div", { class: "field" }, h("label", { for: input.id }, field.label), input, field.hint && h("div", { class: "quiet", id: `${input.id}-hint` }, field.hint))),
      attempt && waits,
      h("div", { class: "row" },
        cancel && h("button", { type: "button", onclick: () => { if (!isBusy) dialog.close(); } }, cancel),
        h("button", { type: "submit", class: danger ? "danger primary" : "primary" }, confirm)));
    const setBusy = (now) => {
      isBusy = now;
      form.setAttribute("aria-busy", String(now));
      waits.textContent = now ? busy : "";
      // Not `disabled`: a button that loses the focus gives it to nobody, and Escape would no longer be heard here.
      for (const button of form.querySelectorAll("button")) button.setAttribute("aria-disabled", String(now));
      for (const [, input] of inputs) input.readOnly = now;
      if (now) replace(refused);
    };
    const askAgain = () => {
      for (const [field, input] of inputs) if (field.type === "password") input.value = "";
      focusOn(inputs[0]?.[1]);
    };
    const dialog = h("dialog", { "aria-labelledby": id }, form);
    dialog.addEventListener("keydown", (event) => { if (isBusy && event.key === "Escape") event.preventDefault(); });
    dialog.addEventListener("cancel", (event) => { if (isBusy) event.preventDefault(); });
    dialog.addEventListener("close", () => {
      dialog.remove();
      focusAgain(before, key);
      if (failure) reject(failure);
      else resolve(answer);
    });
    document.body.append(dialog);
    dialog.showModal();
  });
}

/**
 * Give the focus to an element. A browser would put it in the middle of the window, whatever that hides: it is scrolled no
 * further than to show it, and not at all with `stay`, where what stands above is what they are to see.
 */
export function focusOn(node, { stay = false } = {}) {
  if (!node) return;
  node.focus({ preventScroll: true });
  if (!stay) node.scrollIntoView({ block: "nearest" });
}

/** Focus what had the focus; what stands in its place, by its key, if it was drawn anew meanwhile; else the page's content. */
function focusAgain(before, key) {
  const drawn = before?.isConnected ? before : key !== undefined && document.querySelector(`[data-key="${CSS.escape(key)}"]`);
  focusOn(drawn || document.getElementById("main"), { stay: !drawn });
}

function makeInput(field, id) {
  const shared = { id, name: field.name, required: field.required, autocomplete: field.autocomplete ?? "off", "aria-describedby": field.hint ? `${id}-hint` : undefined };
  if (field.options) {
    const select = h("select", shared, field.options.map((option) => h("option", { value: option.value }, option.label)));
    if (field.value !== undefined) select.value = field.value;
    return select;
  }
  if (field.type === "checkbox") return h("input", { ...shared, type: "checkbox", checked: Boolean(field.value) });
  return h("input", { ...shared, type: field.type ?? "text", value: field.value ?? "", min: field.min, max: field.max, step: field.step });
}

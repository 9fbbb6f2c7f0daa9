// Every fault of the command line as buttons and forms. The server reads, refuses and does them as the commands do.

import { announce, ask, focusOn, h, isAtWork, replace, setAtWork } from "./shared/dom.js";
import { fetchJson, keepOpen } from "./shared/fetching.js";
import { arrange, createKept } from "./keeping.js";
import { refusals } from "./offers.js";

const GROUPS_MAX_COUNT = 4;

/** Do a fault; tell what came of it in `said`. Returns whether it was done. Until then `button` does nothing more. */
async function carryOut(said, fields, button) {
  if (isAtWork(button)) return false;
  setAtWork(button, true);
  replace(said, h("p", { class: "notice" }, "…"));
  try {
    const answer = await keepOpen(() => fetchJson("./api/faults", { method: "POST", body: fields }));
    replace(said, h("p", { class: "notice good" }, `Done: ${answer.done}.`));
    announce(`Done: ${answer.done}.`);
    return true;
  } catch (problem) {
    showProblem(said, problem);
    return false;
  } finally {
    setAtWork(button, false);
  }
}

/** Show a refusal with its code and next step. */
export function showProblem(said, problem) {
  replace(said, h("div", { class: "notice bad" }, h("p", {}, problem.detail ?? String(problem)), problem.code && h("p", { class: "quiet" }, `${problem.code}. ${problem.nextStep}`)));
  announce(problem.detail ?? "It failed.");
}

function panel({ id, title, hint }, ...children) {
  return h("div", { class: "panel", id: `panel-${id}`, role: "tabpanel", "aria-labelledby": `tab-${id}` }, h("h3", {}, title), hint && h("p", { class: "quiet" }, hint), ...children);
}

/**
 * {element, isOfToday(...names), select(name), selectLink(from, to), toggleGroup(name), showPlan(plan), update(moment), setNetwork};
 * onGroups(Map|null), isGrouping(). A node of the past cannot be chosen: what is broken is broken now.
 */
export function createFaults({ network, choices, onSelect, onGroups }) {
  const said = h("div", { class: "said" });
  let names = network.nodes.map((node) => node.name);
  const nodePanel = createNodePanel({ network, choices, said, onSelect });
  const partition = createPartitionPanel({ names, said, onGroups });
  const link = createLinkPanel({ names, choices, said });
  const plan = createPlanPanel({ said });
  const panels = { node: nodePanel, partition, link, plan };
  const titles = { node: "A node", partition: "Partition", link: "A link", plan: "A plan" };
  let open = "node";
  const tabs = Object.keys(panels).map((id) => h("button", { type: "button", role: "tab", id: `tab-${id}`, "aria-controls": `panel-${id}`, onclick: () => choose(id, false), onkeydown: move }, titles[id]));
  function choose(id, focus) {
    open = id;
    Object.keys(panels).forEach((key, index) => {
      panels[key].element.hidden = key !== id;
      tabs[index].setAttribute("aria-selected", String(key === id));
      tabs[index].tabIndex = key === id ? 0 : -1;
      if (focus && key === id) focusOn(tabs[index]);
    });
    onGroups(id === "partition" ? partition.groups() : null);
  }
  function move(event) {
    const ids = Object.keys(panels);
    const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (!step) return;
    event.preventDefault();
    choose(ids[(ids.indexOf(open) + step + ids.length) % ids.length], true);
  }
  const heal = h("button", { type: "button", onclick: (event) => carryOut(said, { do: "heal" }, event.currentTarget) }, "Heal everything");
  const element = h("section", { class: "card break", "aria-labelledby": "break-title" },
    h("div", { class: "row" }, h("h2", { id: "break-title" }, "Break it, mend it"), h("span", { class: "push" }), heal),
    h("div", { class: "tabs", role: "tablist", "aria-label": "What to break" }, tabs),
    Object.values(panels).map((one) => one.element), said);
  choose("node", false);
  const isOfToday = (...asked) => {
    const gone = asked.find((name) => !names.includes(name));
    if (gone) announce(`${gone} is not in the network now: nothing of it can be chosen.`);
    return !gone;
  };
  return {
    element,
    isOfToday,
    isGrouping: () => open === "partition",
    toggleGroup(name) { if (isOfToday(name)) partition.toggle(name); },
    select(name) {
      if (!isOfToday(name)) return;
      nodePanel.select(name);
      if (open !== "partition") choose("node", false);
    },
    selectLink(from, to) {
      if (!isOfToday(from, to)) return;
      link.select(from, to);
      choose("link", false);
    },
    showPlan: (running) => plan.show(running),
    update: (moment) => nodePanel.update(moment),
    setNetwork(changed) {
      names = changed.nodes.map((node) => node.name);
      nodePanel.setNetwork(changed);
      for (const part of [partition, link]) part.setNames(names);
    },
  };
}

function fillOptions(select, values, label = (value) => value) {
  const kept = select.value;
  replace(select, values.map((value) => h("option", { value }, label(value))));
  if (values.includes(kept)) select.value = kept;
}

function field(label, input, hint) {
  return h("div", { class: "field" }, h("label", { for: input.id }, label), input, hint && h("div", { class: "quiet" }, hint));
}

function createNodePanel({ network, choices, said, onSelect }) {
  const state = { network, moment: null, shown: "", buttons: new Map() };
  const why = h("ul", { class: "quiet why", "aria-label": "What makes no sense now" });
  const offer = () => showOffers(state, select.value, why);
  const select = h("select", { id: "node-select", onchange: () => { offer(); onSelect(select.value); } });
  fillOptions(select, network.nodes.map((node) => node.name));
  const sure = (title, text, confirm, fields = []) => ask({ title, body: h("p", {}, text), confirm, cancel: "Leave it", danger: true, fields });
  const run = async (event, fault, fields, question) => {
    const button = event.currentTarget;
    const reason = refusals(select.value, state.network.nodes.find((node) => node.name === select.value), state.moment)[fault];
    if (reason) { announce(reason); return; }
    if (isAtWork(button)) return;
    const answer = question ? await question() : {};
    if (answer) await carryOut(said, { ...fields, node: select.value, ...answer }, button);
  };
  const button = (fault, text, fields, question, danger) => {
    const made = h("button", { type: "button", class: danger ? "danger" : undefined, onclick: (event) => run(event, fault, fields, question) }, text);
    state.buttons.set(fault, made);
    return made;
  };
  const disks = choices.disks.map((disk) => ({ value: disk, label: disk }));
  const element = panel({ id: "node", title: "What to do with a node" }, field("Node", select),
    h("div", { class: "buttons" },
      button("kill", "Kill", { do: "kill" }, () => sure(`Kill ${select.value}?`, "As a power cut would: no last word, nothing flushed. What is final survives.", "Kill it"), true),
      button("restart", "Restart", { do: "restart" }), button("pause", "Pause", { do: "pause" }), button("resume", "Resume", { do: "resume" }),
      button("skew", "Wrong clock…", { do: "skew" }, () => sure(`Set the clock of ${select.value} wrong?`, "A change of it is a jump. 0 sets it right again.", "Set it",
        [{ name: "offset", label: "By how much", value: "+1h", required: true, hint: "Such as +1h, -90s, 250ms or 0" }]), true),
      button("unskew", "Right clock", { do: "skew", offset: "0" }),
      button("fill", "Fill a disk…", { do: "disk", full: true }, () => sure(`Fill a disk of ${select.value}?`, "The node cannot write there until it is free again, and signs nothing meanwhile.", "Fill it",
        [{ name: "disk", label: "The disk under its", options: disks, value: "journal" }]), true),
      button("free", "Free a disk…", { do: "disk", full: false }, () => ask({ title: `Free a disk of ${select.value}`, confirm: "Free it", cancel: "Leave it", fields: [{ name: "disk", label: "The disk under its", options: disks, value: "journal" }] })),
      button("byzantine", "Let it lie…", { do: "byzantine" }, () => askLie(select.value, choices), true),
      button("heal", "Heal it", { do: "heal" })), why);
  return {
    element,
    select(name) { select.value = name; offer(); },
    update(moment) { state.moment = moment; offer(); },
    setNetwork(changed) {
      const before = select.value;
      state.network = changed;
      fillOptions(select, changed.nodes.map((node) => node.name));
      offer();
      if (select.value === before) return;
      if (before) announce(`${before} is not in the network any more${select.value ? `; ${select.value} is chosen now` : ""}.`);
      onSelect(select.value);
    },
  };
}

/** Say of each button that makes no sense for this node why not; it stays where it is, and can be reached and read. */
function showOffers(state, name, why) {
  const found = refusals(name, state.network.nodes.find((node) => node.name === name), state.moment);
  const shown = JSON.stringify(found);
  if (shown === state.shown) return;
  state.shown = shown;
  const reasons = [...new Set(Object.values(found))];
  for (const [fault, button] of state.buttons) {
    if (found[fault]) {
      button.setAttribute("aria-disabled", "true");
      button.setAttribute("aria-describedby", `why-${reasons.indexOf(found[fault])}`);
    } else {
      button.removeAttribute("aria-disabled");
      button.removeAttribute("aria-describedby");
    }
  }
  const label = (reason) => [...state.buttons].filter(([fault]) => found[fault] === reason).map(([, button]) => button.textContent.replace("…", "")).join(", ");
  replace(why, reasons.map((reason, index) => h("li", {}, `${label(reason)}: `, h("span", { id: `why-${index}` }, reason))));
  why.hidden = !reasons.length;
}

async function askLie(name, choices) {
  const boxes = choices.behaviours.map((behaviour) => ({ name: behaviour.name, label: behaviour.name, type: "checkbox", hint: behaviour.meaning }));
  const answer = await ask({ title: `Let ${name} lie?`, body: h("p", {}, "It starts again as one that lies with its genuine key. Two signatures of one round are evidence: it may be suspended, honest or not, until the organisations take it back."),
    confirm: "Let it lie", cancel: "Leave it", danger: true, fields: [...boxes, { name: "seed", label: "Seed", type: "number", value: "0", min: 0, required: true }] });
  if (!answer) return null;
  const chosen = choices.behaviours.map((behaviour) => behaviour.name).filter((behaviour) => answer[behaviour]);
  return { behaviour: chosen.join("+"), seed: Number(answer.seed) };
}

function createPartitionPanel({ names, said, onGroups }) {
  let groups = new Map(names.map((name) => [name, 0]));
  const list = h("div", { class: "groups" });
  const changed = () => { draw(); onGroups(groups); };
  const letters = Array.from({ length: GROUPS_MAX_COUNT }, (_, index) => String.fromCharCode(65 + index));
  const rows = createKept();
  const make = (name) => h("fieldset", { class: "group-row" }, h("legend", {}, name), letters.map((letter, index) => h("label", { class: `choice group-${index}` },
    h("input", { type: "radio", name: `group-${name}`, onchange: () => { groups.set(name, index); onGroups(groups); } }), letter)));
  const draw = () => {
    rows.keep(groups.keys());
    arrange(list, [...groups].map(([name, group]) => {
      const row = rows.get(name, () => make(name));
      row.querySelectorAll("input")[group].checked = true;
      return row;
    }));
  };
  const cut = async (event) => {
    const sides = letters.map((_, index) => [...groups].filter(([, group]) => group === index).map(([name]) => name)).filter((side) => side.length);
    await carryOut(said, { do: "partition", groups: sides.map((side) => side.join(",")).join(" | ") }, event.currentTarget);
  };
  const element = panel({ id: "partition", title: "Cut the network into groups", hint: "Choose a group for each node here, or click nodes in the drawing. Groups hear nothing of each other; a new partition takes the place of the last one. Healing ends it, and every other fault too: wrong clocks, full disks, pauses, lies and sick links." },
    list, h("div", { class: "buttons" }, h("button", { type: "button", class: "danger", onclick: cut }, "Cut it"),
      h("button", { type: "button", onclick: () => { groups = new Map([...groups].map(([name]) => [name, 0])); changed(); } }, "All in one group again"),
      h("button", { type: "button", onclick: (event) => carryOut(said, { do: "heal" }, event.currentTarget) }, "Heal every fault")));
  draw();
  return {
    element,
    groups: () => groups,
    toggle(name) {
      groups.set(name, (groups.get(name) + 1) % Math.min(GROUPS_MAX_COUNT, 2 + (Math.max(...groups.values()) > 0 ? 1 : 0)));
      changed();
      announce(`${name} is in group ${letters[groups.get(name)]}.`);
    },
    setNames(all) { groups = new Map(all.map((name) => [name, groups.get(name) ?? 0])); draw(); },
  };
}

function createLinkPanel({ names, choices, said }) {
  const from = h("select", { id: "link-from" });
  const to = h("select", { id: "link-to" });
  const setNames = (all) => { fillOptions(from, all); fillOptions(to, all); if (from.value === to.value && all.length > 1) to.value = all.find((name) => name !== from.value); };
  setNames(names);
  const both = h("input", { type: "checkbox", id: "link-both", checked: true });
  const cut = h("input", { type: "checkbox", id: "link-cut" });
  const profile = h("select", { id: "link-profile" }, h("option", { value: "" }, "none"), choices.profiles.map((one) => h("option", { value: one.name }, `${one.name}: ${one.meaning}`)));
  const number = (id, most, step) => h("input", { id, type: "number", min: 0, max: most, step, inputmode: "decimal" });
  const figures = { delay_ms: number("link-delay", 60000, "any"), jitter_ms: number("link-jitter", 60000, "any"), loss: number("link-loss", 0.999, "any"), bandwidth_kbytes_per_s: number("link-bandwidth", 1e9, "any") };
  const seed = h("input", { id: "link-seed", type: "number", min: 0, step: 1, value: "0" });
  const name = () => `${from.value} ${both.checked ? "<->" : "->"} ${to.value}`;
  const spoil = (event) => {
    event.preventDefault();
    const fields = { do: "link", link: name(), seed: Number(seed.value) };
    if (profile.value) fields.profile = profile.value;
    if (cut.checked) fields.cut = true;
    for (const [key, input] of Object.entries(figures)) if (input.value !== "") fields[key] = Number(input.value);
    carryOut(said, fields, event.submitter);
  };
  const element = panel({ id: "link", title: "Make a link slow, lossy, narrow, or cut it", hint: "A figure takes the place of the profile's. For both directions a round trip takes twice the delay." },
    h("form", { onsubmit: spoil },
      h("div", { class: "pair" }, field("From", from), field("To", to)),
      h("div", { class: "field" }, h("label", { class: "switch" }, both, "both directions")),
      field("Profile", profile),
      h("div", { class: "pair" }, field("Delay, ms", figures.delay_ms), field("Jitter, ms", figures.jitter_ms)),
      h("div", { class: "pair" }, field("Share lost, 0 to 1", figures.loss), field("Bandwidth, kB/s", figures.bandwidth_kbytes_per_s)),
      h("div", { class: "pair" }, field("Seed", seed), h("div", { class: "field" }, h("label", { class: "switch cut-switch" }, cut, "cut: nothing goes through"))),
      h("div", { class: "buttons" }, h("button", { type: "submit", class: "danger" }, "Spoil it"),
        h("button", { type: "button", onclick: (event) => carryOut(said, { do: "link", link: name() }, event.currentTarget) }, "Make it sound"))));
  return { element, setNames, select(a, b) { from.value = a; to.value = b; } };
}

const EXAMPLE = `seed = 7

[[step]]
at = "1s"
do = "partition"
groups = "node-1"

[[step]]
at = "6s"
do = "heal"

[[random]]
from = "10s"
to = "40s"
every = "10s"
lasting = "5s"
do = ["kill", "pause", "link"]
`;

function createPlanPanel({ said }) {
  const text = h("textarea", { id: "plan-text", rows: 10, spellcheck: "false", class: "mono" });
  text.value = EXAMPLE;
  const seed = h("input", { id: "plan-seed", type: "number", min: 0, step: 1, value: "7", onchange: () => {
    const line = `seed = ${Number(seed.value) || 0}`;
    text.value = /^seed\s*=.*$/m.test(text.value) ? text.value.replace(/^seed\s*=.*$/m, line) : `${line}\n\n${text.value}`;
  } });
  const steps = h("div", { class: "scroll", tabindex: 0, role: "region", "aria-label": "Steps of the plan" });
  const stop = h("button", { type: "button", hidden: true, onclick: () => fetchJson("./api/plans/stop", { method: "POST", body: {} }).catch((problem) => showProblem(said, problem)) }, "Stop it");
  let isShowingRun = false;
  let shown = "";
  const check = async () => {
    replace(said);
    shown = "";
    try {
      const plan = await fetchJson("./api/plans/check", { method: "POST", body: { text: text.value } });
      isShowingRun = false;
      replace(steps, stepsTable(plan));
      announce(`${plan.steps.length} steps. Nothing is done.`);
      return plan;
    } catch (problem) {
      replace(steps);
      showProblem(said, problem);
      return null;
    }
  };
  const start = async () => {
    const plan = await check();
    if (!plan) return;
    const last = plan.steps.at(-1);
    const sure = await ask({ title: "Carry the plan out?", body: h("p", {}, `${plan.steps.length} steps in ${Math.round(last.at_ms / 1000)} seconds, seed ${plan.seed}. Steps that cannot be done are told, and the plan goes on.`), confirm: "Carry it out", cancel: "Leave it", danger: true });
    if (!sure) return;
    try {
      await fetchJson("./api/plans", { method: "POST", body: { text: text.value } });
      isShowingRun = true;
    } catch (problem) {
      showProblem(said, problem);
    }
  };
  const begin = h("button", { type: "button", class: "danger", onclick: start }, "Carry it out");
  const element = panel({ id: "plan", title: "A plan of timed and random faults", hint: "TOML, as for blockrobot fault run. Random steps and sick links are drawn from the seed." },
    field("Seed", seed), field("Plan", text),
    h("div", { class: "buttons" }, h("button", { type: "button", onclick: check }, "Show the steps"), begin, stop), steps);
  return {
    element,
    show(plan) {
      const isOver = plan?.state !== "running";
      if (isOver && document.activeElement === stop) focusOn(begin); // what is hidden would take the focus with it
      stop.hidden = isOver;
      if (plan && (isShowingRun || plan.state === "running")) {
        isShowingRun = true;
        const now = JSON.stringify(plan);
        if (now !== shown) replace(steps, stepsTable(plan));
        shown = now;
      }
    },
  };
}

function stepsTable(plan) {
  const came = (step) => (step.error ? `${step.error.code}` : step.done_at_ms !== undefined ? "done" : plan.state === "running" ? "to come" : "not done");
  return h("table", { class: "list steps" }, h("caption", {}, `Seed ${plan.seed}, ${plan.steps.length} steps${plan.state ? `: ${plan.state}` : "; nothing is done"}`),
    h("thead", {}, h("tr", {}, h("th", { scope: "col", class: "number" }, "at"), h("th", { scope: "col" }, "do"), plan.state && h("th", { scope: "col" }, "came of it"))),
    h("tbody", {}, plan.steps.map((step) => h("tr", {}, h("td", { class: "number" }, `${(step.at_ms / 1000).toFixed(1)} s`), h("td", {}, step.do),
      plan.state && h("td", { title: step.error?.detail }, came(step))))));
}

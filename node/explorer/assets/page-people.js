// Members and organisations, as far as the chain says. People who are recorded are counted, never listed.

import { h } from "./shared/dom.js";
import { plural } from "./shared/format.js";
import { api, objectOf } from "./api.js";
import { badge, card, go, hex, number, sheet, table } from "./pieces.js";

const ROLES = {
  subject: ["person who may be recorded", "people who may be recorded"],
  staff: ["member of staff", "members of staff"],
  robot: ["robot", "robots"],
  officer: ["data protection officer", "data protection officers"],
  auditor: ["auditor", "auditors"],
};

export async function peoplePage() {
  const [organisations, nodes, producers, members] = await Promise.all([readOrganisations(), api.view("membership", "list_nodes"), api.producers(), readMembers()]);
  const custodians = await api.view("identity", "custodians");
  const seats = new Map(producers.producers.map((one) => [one.name, one]));
  return sheet("Members and organisations",
    "Organisations run the nodes and decide together. Members are persons and robots with a key of their own, registered by an organisation. Of people the chain knows keys and random handles, no names; each visit of a patient has yet another key, so nobody can be followed.",
    card("Organisations", table("Active organisations", ["name", ["admins", "number"], "nodes that produce"], organisations.map((one) => [one.name, one.admins ?? "–", producers.producers.filter((known) => known.organisation === one.name && known.status !== "removed").map((known) => known.name).join(", ") || "none"]))),
    card("Nodes", table("Active nodes", ["name", "organisation", "role"], nodes.map((name) => {
      const seat = seats.get(name);
      return [seat ? go(`producers/${encodeURIComponent(name)}`, name) : name, seat?.organisation ?? "–", seat ? badge(seat.status, seat.status === "producing" ? "good" : "") : badge("follows")];
    })), h("p", { class: "quiet" }, `${plural(custodians.length, "node is a custodian", "nodes are custodians")}: they keep what robots recorded, as ciphertext that they cannot open.`)),
    card("Members", h("p", {}, `Registered, and neither left nor revoked, since block ${number(members.from)}${members.isAll ? "" : `, up to block ${number(members.upTo)}: there is more than this page reads at once`}:`),
      h("ul", {}, Object.entries(ROLES).map(([role, [one, many]]) => h("li", {}, plural(members.counts.get(role) ?? 0, one, many))))),
    card("Robots and officials", h("p", { class: "quiet" }, "Those who act for an organisation are listed, newest first. People who are recorded are counted above and not listed here."),
      table("Robots, staff, officers and auditors", ["role", "key", "called", "registered in"], members.listed.map((one) => [badge(one.role), hex(one.key), [one.name, one.place].filter(Boolean).join(", ") || "–", [go(`block/${one.height}`, `block ${one.height}`), ", ", go(`tx/${one.txid}`, "transaction")]]))));
}

async function readOrganisations() {
  const names = await api.view("membership", "active_organisations");
  return Promise.all(names.map(async (name) => ({ name, admins: await api.view("identity", "admin_count", name).catch(() => null) })));
}

/** Follow who was registered, changed keys, left or was revoked. */
async function readMembers() {
  const { earliest_height: from } = await api.status();
  const { events, isAll, upTo } = await api.events({ from, contract: "identity", pagesMax: 30 });
  const roles = new Map();
  for (const event of events) {
    const data = objectOf(event.data);
    const key = data.member?.hex;
    if (event.name === "registered") roles.set(key, { key, role: data.role, height: event.height, txid: event.txid });
    if (event.name === "rotated" && roles.has(key)) roles.set(data.new_member.hex, { ...roles.get(key), key: data.new_member.hex });
    if (event.name === "robot_named" && roles.has(key)) Object.assign(roles.get(key), { name: data.name, place: data.place });
    if (event.name === "rotated" || event.name === "left" || event.name === "revoked") roles.delete(key);
  }
  const counts = new Map();
  for (const { role } of roles.values()) counts.set(role, (counts.get(role) ?? 0) + 1);
  const listed = [...roles.values()].filter((one) => one.role !== "subject").reverse().slice(0, 100);
  return { counts, listed, from, isAll, upTo };
}

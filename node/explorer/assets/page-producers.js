// Producers: what each did in the newest blocks, who votes for it, and why one is suspended.

import { h, replace } from "./shared/dom.js";
import { bars } from "./shared/chart.js";
import { plural } from "./shared/format.js";
import { api } from "./api.js";
import { feed } from "./feed.js";
import { badge, card, chartWidth, facts, fullHex, go, hex, number, sheet, table } from "./pieces.js";

const TONES = { producing: "good", candidate: "", suspended: "bad", removed: "bad" };

export async function producersPage({ args: [wanted], signal }) {
  await feed.fill().catch(() => {});
  const { producers, epoch, height } = await api.producers();
  const done = await countWork();
  const seats = await api.epoch(epoch).catch(() => null);
  const span = feed.headers.length ? `blocks ${feed.headers[0].height} to ${feed.last}` : "no blocks";
  const rows = producers.map((producer) => {
    const work = done.get(producer.key) ?? { led: 0, voted: 0, missed: 0, certificates: 0 };
    const share = work.certificates ? Math.round((100 * work.voted) / work.certificates) : null;
    return [
      h("span", { class: producer.name === wanted ? "here" : "" }, producer.name),
      producer.organisation,
      badge(producer.status, TONES[producer.status] ?? ""),
      number(work.led),
      number(work.missed),
      share === null ? "–" : `${number(work.voted)} (${share} %)`,
      producer.votes.join(", ") || "none",
      hex(producer.key),
    ];
  });
  const suspended = producers.filter((producer) => producer.evidence);
  return sheet("Producers",
    `Producers take turns in leading rounds and vote on what the others propose. ${seats ? `Of ${plural(seats.seats.length, "seat", "seats")}, ${seats.quorum} make a quorum: the chain goes on, and stays right, while at most ${seats.faults_tolerated} of them fail, lie or keep silent.` : ""} Organisations vote for producers; evidence of signing two things in one round suspends one.`,
    card("What they did", h("p", { class: "quiet" }, `Counted from ${span}. A certificate holds exactly a quorum of votes, the first that came, so a share below 100 % is no fault by itself. A missed round is one that a producer should have led and that was given up.`),
      table("Producers and candidates", ["name", "organisation", "state", ["blocks led", "number"], ["rounds missed", "number"], ["votes in certificates", "number"], "organisations for it", "key"], rows)),
    card("Votes in certificates", h("p", { class: "quiet" }, `By producer, in ${span}.`), votesChart(producers.map((producer) => ({ name: producer.name, value: done.get(producer.key)?.voted ?? 0 })), signal)),
    card("Suspensions and evidence", suspended.length ? suspended.map(evidenceView) : h("p", {}, `Nobody is suspended at block ${number(height)}, and there is no evidence against anybody who produces or stands for it.`)));
}

/** Bars that are drawn anew for each width: their words stay legible. */
function votesChart(items, signal) {
  const place = h("div", {});
  const draw = () => replace(place, bars({ items, width: chartWidth(), height: 180, label: "Votes in certificates by producer", unit: "votes" }));
  addEventListener("resize", draw, { signal });
  draw();
  return place;
}

/** Count by key, over the headers that are here: seats change their holders with the epoch. */
async function countWork() {
  const done = new Map();
  const epochs = new Map();
  for (const header of feed.headers) {
    if (header.height === 0) continue;
    if (!epochs.has(header.epoch)) epochs.set(header.epoch, await api.epoch(header.epoch).catch(() => null));
    const seats = epochs.get(header.epoch)?.seats;
    if (!seats) continue;
    const of = (index) => {
      const { key } = seats[index];
      if (!done.has(key)) done.set(key, { led: 0, voted: 0, missed: 0, certificates: 0 });
      return done.get(key);
    };
    of(header.producer).led += 1;
    for (const index of header.missed) of(index).missed += 1;
    if (header.certificate) {
      for (const seat of seats) of(seat.index).certificates += 1;
      for (const index of header.certificate.voters) of(index).voted += 1;
    }
  }
  return done;
}

function evidenceView(producer) {
  const { evidence } = producer;
  const what = evidence.kind === "vote" ? "voted for two different blocks" : "proposed two different blocks";
  return h("div", { class: "stack" }, h("h3", {}, producer.name, " ", badge(producer.status, TONES[producer.status] ?? "")),
    h("p", {}, `In round ${evidence.round} of epoch ${evidence.epoch} it signed twice: it ${what}. Both signatures stand on the chain; anybody can check them.`),
    facts([
      ["since", go(`block/${evidence.height}`, `block ${evidence.height}`)],
      ["one block", fullHex(evidence.first_id)],
      ["the other", fullHex(evidence.second_id)],
      ["what brings it back", "a new majority of organisations that vote for it"],
    ]));
}

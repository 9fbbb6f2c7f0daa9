"""The bundle's two files for readers without BlockRobot."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from typing import Any

from clients.bundle import documents as doc
from clients.sdk.pictures.depth_colours import scale_css

README_TEXT = """\
What is in here
===============

This is what a robot's network holds of one person, exported by that person (GDPR, Articles 15 and 20).

  play.html        plays the pictures in any browser, once this file is unpacked, and tells which were erased and who
                   confirmed that; it asks nobody for anything
  pictures/        what was recorded, in order: one folder a visit. Only the person; everything else is the empty room.
                   Colours are distances: bright near (0.4 m), dark far (8 m), grey not measured.
  depth/           the same as 16-bit PNG in millimetres, the person alone, 0 elsewhere
  sounds/ labels/  other senses, where there are any
  data/            everything about it as JSON: visits and records, the audit trail, who asked for access, what was
                   erased and who confirmed, restrictions and corrections, consents. schema.json says what each
                   field means.
  proofs/          what shows that all of it is so
  committed/ backgrounds/   the very bytes that the robot committed to, and the recorded empty rooms
  genesis.json     the network, as it began
  manifest.json    every file with its hash; what was asked for; what is missing and why
  signatures.json  made with the keys of the visits in here

How to check it
===============

  blockrobot verify THIS_FILE --genesis GENESIS_FILE

needs no network and no wallet. Without --genesis it can only say that the file agrees with itself: get the network's
genesis file, or its hash, from somebody else than whoever gave you this.

What handing it on gives away
=============================

Whoever has this file knows that these visits were of one person, what the pictures show, and when; if data/consents.json
names a member key, also which member of the network that is. It holds no key that opens anything else, and none that
acts in the person's name. What was handed on cannot be taken back: erasing records later does not reach this copy.
"""

_PAGE = """\
<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; img-src 'self' file:; \
style-src 'unsafe-inline'; script-src 'unsafe-inline'">
<title>What was recorded of me</title>
<style>
[hidden] { display: none !important; }
#gone { border: 2px dashed; padding: 4rem 1rem; text-align: center; }
body { font: 16px/1.5 sans-serif; margin: 2rem auto; max-width: 56rem; padding: 0 1rem; }
img { background: #484848; display: block; image-rendering: pixelated; width: 100%; }
button, select { font: inherit; padding: .3rem .8rem; }
input[type=range] { width: 100%; }
.scale { background: %colours; height: .8rem; }
.ends { display: flex; justify-content: space-between; }
</style>
</head>
<body>
<h1>What was recorded of me</h1>
<p><label>Visit <select id="visit"></select></label>
<button id="play" type="button">Play</button> <span id="place" aria-live="polite"></span></p>
<p><label>Picture <input id="slide" type="range" min="0" value="0"></label></p>
<img id="picture" alt="The picture at this place of the visit">
<p id="gone" hidden></p>
<div id="scale"><div class="scale"></div>
<div class="ends"><span>near: 0.4 m</span><span>grey: not measured</span><span>far: 8 m</span></div></div>
<section id="erasures" hidden>
<h2>What was erased</h2>
<ul id="erased"></ul>
</section>
<noscript><p>The pictures are in the folder pictures, in order. What was erased: data/erasures.json.</p></noscript>
<script>
"use strict";
const visits = %visits;
const custodians = %custodians;
const by = id => document.getElementById(id);
let frames = [], place = 0, timer = 0;
const two = (value) => String(value).padStart(2, "0");
function zoneOffset(time) {
  const minutes = -new Date(time).getTimezoneOffset(), size = Math.abs(minutes);
  return minutes ? `UTC${minutes < 0 ? "-" : "+"}${two(Math.floor(size / 60))}:${two(size % 60)}` : "UTC";
}
const shown = new Intl.DateTimeFormat("en-GB", {dateStyle: "medium", timeStyle: "medium", hourCycle: "h23"});
const moment = (time) => `${shown.format(new Date(time))} ${zoneOffset(time)}`;
const short = (hex) => hex.slice(0, 12);
const counted = (count, one) => `${count} ${one}${count === 1 ? "" : "s"}`;
const pictures = (list) => list.filter(([, , , index]) => index >= 0).length;
visits.forEach((visit, number) => {
  const held = pictures(visit.pictures), gone = visit.pictures.length - held;
  const erased = gone ? `, ${counted(gone, "erased record")}` : "";
  by("visit").add(new Option(`${number + 1} (${counted(held, "picture")}${erased})`, number));
});
function item(text, children = []) {
  const made = document.createElement("li");
  made.textContent = text;
  if (children.length) made.append(document.createElement("ul"));
  for (const child of children) made.lastChild.append(child);
  return made;
}
const called = (key) => custodians[key] || `Custodian ${short(key)}`;
const destroyed = (count) => `the ${count === 1 ? "key" : "keys"} of ${counted(count, "picture")} `
  + `${count === 1 ? "is" : "are"} destroyed.`;
function tellErasure(erasure) {
  const places = erasure.frames.map(frame => frame + 1).join(", ");
  const what = places ? `picture${erasure.frames.length === 1 ? "" : "s"} ${places} of the record` : "whole records:";
  const waits = erasure.custodians.filter(key => !erasure.receipts.some(one => one.custodian === key));
  const receipts = erasure.receipts.map(one => item(
    `${called(one.custodian)} confirmed on ${moment(one.time_ms)}: ${destroyed(one.destroyed_frames)}`));
  receipts.push(...waits.map(key => item(`${called(key)} had not confirmed.`)));
  return item(`Asked on ${moment(erasure.time_ms)} to erase ${what} ${erasure.records.map(short).join(", ")}`, receipts);
}
function show(next) {
  if (!frames.length) { by("place").textContent = "There are no pictures."; by("scale").hidden = true; return; }
  place = Math.max(0, Math.min(next, frames.length - 1));
  const [name, time, record, index] = frames[place];
  by("picture").hidden = !name;
  by("gone").hidden = Boolean(name);
  if (name) by("picture").src = name;
  else by("gone").textContent = `${index < 0 ? "Record" : `Picture ${index + 1} of record`} ${short(record)} was erased.`;
  by("slide").value = place;
  by("scale").hidden = !name;
  // A record that was erased as a whole no longer says how many pictures it had: it is counted by itself.
  const held = pictures(frames), before = pictures(frames.slice(0, place + 1));
  by("place").textContent = (index < 0 ? `Erased record ${place + 1 - before} of ${frames.length - held}`
    : `Picture ${before} of ${held}`) + (time ? `, ${moment(time)}` : "");
}
function stop() { clearTimeout(timer); timer = 0; by("play").textContent = "Play"; }
function step() {
  if (place + 1 >= frames.length) { stop(); return; }
  const wait = Math.max(20, Math.min(2000, frames[place + 1][1] - frames[place][1]));
  timer = setTimeout(() => { show(place + 1); step(); }, wait);
}
function choose(number) {
  const visit = visits[number] || {pictures: [], erasures: []};
  stop();
  frames = visit.pictures;
  by("erasures").hidden = !visit.erasures.length;
  by("erased").replaceChildren(...visit.erasures.map(tellErasure));
  by("slide").max = frames.length - 1;
  show(0);
}
by("visit").onchange = event => choose(event.target.value);
by("slide").oninput = event => { stop(); show(Number(event.target.value)); };
by("play").onclick = () => {
  if (timer) { stop(); return; }
  by("play").textContent = "Pause";
  if (place + 1 >= frames.length) show(0);
  step();
};
choose(0);
</script>
</body>
</html>
"""


def player_page(
    visits: Sequence[doc.VisitDocument], erasures: Sequence[doc.ErasureDocument], names: Mapping[str, str]
) -> bytes:
    """`names` by custodian key (hex)."""
    played = [
        {
            "pictures": [picture for record in visit.records for picture in _pictures_of(record)],
            "erasures": [_erasure(each) for each in erasures if each.owner == visit.owner],
        }
        for visit in visits
    ]
    parts = {"%colours": scale_css(), "%visits": _in_script(played), "%custodians": _in_script(names)}
    return re.sub("|".join(parts), lambda found: parts[found[0]], _PAGE).encode()


def _in_script(value: Any) -> str:
    """Escape a value for a script element, closing tag included."""
    return json.dumps(value, separators=(",", ":")).replace("<", "\\u003c")


def _pictures_of(record: doc.RecordDocument) -> list[tuple[str, int, str, int]]:
    """Empty name: erased; index -1: whole record."""
    if not record.frames and record.status != "active":
        return [("", 0, record.record_id, -1)]
    found = []
    for frame in record.frames:
        names = [""] if frame.status == "erased" else [name for name in frame.files if name.startswith("pictures/")]
        found += [(name, frame.captured_at_ms, record.record_id, frame.index) for name in names]
    return found


def _erasure(erasure: doc.ErasureDocument) -> dict[str, Any]:
    shown = {name: getattr(erasure, name) for name in ("records", "frames", "time_ms", "custodians")}
    receipts = [
        {"custodian": one.custodian, "destroyed_frames": one.destroyed_frames, "time_ms": one.time_ms}
        for one in erasure.receipts
    ]
    return shown | {"receipts": receipts}

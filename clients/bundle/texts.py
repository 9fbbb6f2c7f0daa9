"""The two files of a bundle for people without any of our programs. Must never change within one version of the format."""

from __future__ import annotations

import json
from collections.abc import Sequence

README_TEXT = """\
What is in here
===============

This is what a robot's network holds of one person, exported by that person (GDPR, Articles 15 and 20).

  play.html        plays the pictures in any browser, once this file is unpacked; it asks nobody for anything
  pictures/        what was recorded, in order: one folder a visit. Only the person; everything else is the empty room.
                   Colours are distances: blue near (0.4 m), red far (8 m), dark grey not measured.
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
body { font: 16px/1.5 sans-serif; margin: 2rem auto; max-width: 56rem; padding: 0 1rem; }
img { background: #303030; display: block; image-rendering: pixelated; width: 100%; }
button, select { font: inherit; padding: .3rem .8rem; }
input[type=range] { width: 100%; }
.scale { background: linear-gradient(90deg, #30123b, #28bceb, #a4fc3c, #fb7e21, #7a0403); height: .8rem; }
.ends { display: flex; justify-content: space-between; }
</style>
</head>
<body>
<h1>What was recorded of me</h1>
<p><label>Visit <select id="visit"></select></label>
<button id="play" type="button">Play</button> <span id="place" aria-live="polite"></span></p>
<p><label>Picture <input id="slide" type="range" min="0" value="0"></label></p>
<img id="picture" alt="The picture at this place of the visit">
<div class="scale"></div>
<div class="ends"><span>near: 0.4 m</span><span>dark grey: not measured</span><span>far: 8 m</span></div>
<noscript><p>The pictures are in the folder pictures, in order.</p></noscript>
<script>
"use strict";
const visits = %s;
const by = id => document.getElementById(id);
let frames = [], place = 0, timer = 0;
visits.forEach((visit, number) => by("visit").add(new Option(`${number + 1} (${visit.length} pictures)`, number)));
function show(next) {
  if (!frames.length) { by("place").textContent = "There are no pictures."; return; }
  place = Math.max(0, Math.min(next, frames.length - 1));
  const [name, time] = frames[place];
  by("picture").src = name;
  by("slide").value = place;
  by("place").textContent = `${place + 1} of ${frames.length}, ${new Date(time).toLocaleString()}`;
}
function stop() { clearTimeout(timer); timer = 0; by("play").textContent = "Play"; }
function step() {
  if (place + 1 >= frames.length) { stop(); return; }
  const wait = Math.max(20, Math.min(2000, frames[place + 1][1] - frames[place][1]));
  timer = setTimeout(() => { show(place + 1); step(); }, wait);
}
function choose(number) { stop(); frames = visits[number] || []; by("slide").max = frames.length - 1; show(0); }
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


def player_page(visits: Sequence[Sequence[tuple[str, int]]]) -> bytes:
    """Return the page that plays pictures: for each visit names and times in ms. Names are a layout's, so need no care."""
    listed = json.dumps([[[name, time_ms] for name, time_ms in visit] for visit in visits], separators=(",", ":"))
    return _PAGE.replace("%s", listed).encode()

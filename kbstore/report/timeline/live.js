"use strict";
// What makes the page of a timeline live: what has changed arrives by server-sent events, and the cursor may follow now.

const follow = element("button", "Follow"), connection = element("span", "", "dim");
let isFollowing = true;
follow.id = "follow"; follow.title = "Keep the cursor at now"; connection.id = "connection";
document.querySelector(".buttons").append(" ", follow, " ", connection);

function setFollowing(on) { isFollowing = on; follow.setAttribute("aria-pressed", on); if (on) toNow(); }
function toNow() {
  cursor = Math.max(0, data.now);
  const size = view[1] - view[0];
  if (cursor > view[1] - size * 0.05 || cursor < view[0]) view = [cursor - size * 0.85, cursor + size * 0.15];
  redraw();
}
// Take later data; who looks at what was believed goes on looking at it.
function take(later) {
  const atNow = belief >= NOW, shift = Number(BigInt(later.origin) - origin);
  const place = chosen;
  absorb(later);
  if (shift) { cursor -= shift; view = view.map((t) => t - shift); }
  if (place) explain();
  setBelief(atNow ? NOW : belief);
  if (isFollowing) toNow();
}
function patched(patch) {
  const later = { ...data };
  for (const [name, value] of Object.entries(patch)) {
    if (!Array.isArray(value)) { later[name] = value; continue; }
    later[name] = data[name].slice(0, value[0]);
    for (const [index, entry] of value[1]) later[name][index] = entry;
  }
  return later;
}

const source = new EventSource(data.stream);
const told = (what) => { connection.textContent = what; };
source.addEventListener("open", () => told("live"));
source.addEventListener("error", () => told(source.readyState === EventSource.CLOSED ? "disconnected: reload the page" : "connecting again"));
source.addEventListener("data", (event) => take(JSON.parse(event.data)));
source.addEventListener("patch", (event) => take(patched(JSON.parse(event.data))));
source.addEventListener("now", (event) => { data.now = Number(event.data); changed += 1; if (isFollowing) toNow(); else redraw(); });

follow.addEventListener("click", () => setFollowing(!isFollowing));
canvas.addEventListener("pointerdown", (event) => { if (event.offsetX >= LABELS) setFollowing(false); });
document.addEventListener("keydown", (event) => { if (["ArrowLeft", "ArrowRight", ",", "."].includes(event.key)) setFollowing(false); });
// a link to a moment shows that moment, and a recording of another day shows that day
setFollowing(!location.hash.includes("t=") && data.now < data.until + 86400e9);

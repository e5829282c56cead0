/* On paper a page is light, also for readers who prefer dark ones; print.css does the rest. */
(function () {
"use strict";
const root = document.documentElement;
let chosen = "light";

function show(theme) {
  root.dataset.theme = theme;
  for (const { live } of document.querySelectorAll(".live-figure")) if (live) { live.recolour(); live.draw(); }
}

addEventListener("beforeprint", () => { chosen = root.dataset.theme; show("light"); });
addEventListener("afterprint", () => show(chosen));
})();

// A figure in frames with a slider, in the place of its still. `edition1_companion.book.frame_strip` writes what it takes:
//   frames   what happens in each frame, in a line
//   still    number of the frame that is shown first
//   svg      one drawing of all frames; the id of what is not in all of them begins with "f-" and names its frames, "f-2-3--7"
// It moves when asked to, and asks for no other file.
(() => {
  "use strict";

  const FRAME_MS = 700;

  function make(tag, attributes, text = "") {
    const element = document.createElement(tag);
    for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
    element.textContent = text;
    return element;
  }

  function mount(strip) {
    const { frames, still, svg } = JSON.parse(strip.querySelector("script").textContent);
    let picture = strip.querySelector("img");
    const alt = picture.alt;
    const pictures = [];
    let current = still;
    let timer = 0; // of the next frame, 0 when paused

    const slider = make("input", { type: "range", min: 0, max: frames.length - 1, step: 1, "aria-label": "Frame" });
    const play = make("button", { type: "button" }, "Play");
    const bar = make("div", { class: "frame-strip-bar" });
    const says = make("p", { class: "frame-strip-says" });
    // readers who ask their system for less motion move the slider themselves
    if (!matchMedia("(prefers-reduced-motion: reduce)").matches) bar.append(play);
    bar.append(slider);
    strip.append(bar, says);

    /** The drawing with what belongs to frame `k`, without the rest. */
    function pictureOf(k) {
      if (!pictures[k]) {
        const rule = `g[id^="f-"]:not([id*="-${k}-"]){display:none}</style>`;
        pictures[k] = make("img", { alt: k === still ? alt : frames[k] });
        pictures[k].src = `data:image/svg+xml,${encodeURIComponent(svg.replace("</style>", rule))}`;
      }
      return pictures[k];
    }

    async function setFrame(k) {
      current = k;
      slider.value = k;
      slider.setAttribute("aria-valuetext", frames[k]);
      says.textContent = frames[k];
      const next = pictureOf(k);
      await next.decode(); // the last picture stays until then
      if (current !== k) return;
      picture.replaceWith(next);
      picture = next;
    }

    function pause() {
      clearTimeout(timer);
      timer = 0;
      play.textContent = "Play";
    }

    function advance() {
      setFrame(current + 1);
      if (current === frames.length - 1) pause();
      else timer = setTimeout(advance, FRAME_MS);
    }

    play.addEventListener("click", () => {
      if (timer) return pause();
      if (current === frames.length - 1) setFrame(0);
      play.textContent = "Pause";
      timer = setTimeout(advance, FRAME_MS);
    });
    slider.addEventListener("input", () => {
      pause();
      setFrame(Number(slider.value));
    });
    setFrame(still);
  }

  document.addEventListener("DOMContentLoaded", () => document.querySelectorAll(".frame-strip").forEach(mount));
})();

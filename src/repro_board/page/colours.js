// Colours of the companion's figures (those of Okabe and Ito), and which theme the page has.

export const ROLES = { estimate: "#D55E00", deviation: "#56B4E9", magnets: "#009E73", sensors: "#0072B2", suspects: "#E60000" };

/** Colours that depend on the theme: the truth is black on light pages and white on dark ones. */
const THEMES = {
  light: { truth: "#000000", body: "#777777", grid: "#c4c4c4", axes: "#555555" },
  dark: { truth: "#ffffff", body: "#aaaaaa", grid: "#4a4a4a", axes: "#bbbbbb" },
};

const darkScheme = matchMedia("(prefers-color-scheme: dark)");

/** All colours for the page as it is: `data-theme` of the html element decides, else the system's preference. */
export function colours() {
  const chosen = document.documentElement.dataset.theme;
  const dark = chosen === "dark" || (chosen !== "light" && darkScheme.matches);
  return { ...ROLES, ...THEMES[dark ? "dark" : "light"] };
}

/** Call `changed` whenever the theme may be another one; returns a function that ends this. */
export function onThemeChange(changed) {
  const observer = new MutationObserver(changed);
  observer.observe(document.documentElement, { attributeFilter: ["data-theme"] });
  darkScheme.addEventListener("change", changed);
  return () => {
    observer.disconnect();
    darkScheme.removeEventListener("change", changed);
  };
}

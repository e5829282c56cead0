/* A link from a live figure brings its settings as `?name=value&...`: they are typed into the form of the notebook. */
addEventListener("load", () => {
  for (const [name, value] of new URLSearchParams(location.search)) {
    const field = document.querySelector(`.run-form input[data-name="${CSS.escape(name)}"]`);
    if (!field) continue;
    if (field.type === "checkbox") field.checked = value === "true";
    else field.value = value;
    field.dispatchEvent(new Event("input", { bubbles: true }));
  }
});

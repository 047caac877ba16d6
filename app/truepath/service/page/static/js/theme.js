/* Light or dark before the first paint, and again when the operator or the system asks. */
(() => {
  "use strict";
  const system = matchMedia("(prefers-color-scheme: dark)");

  function apply() {
    const wanted = localStorage.getItem("truepath.theme") || "auto";
    const dark = wanted === "dark" || (wanted === "auto" && system.matches);
    document.documentElement.dataset.theme = dark ? "dark" : "light";
    document.dispatchEvent(new CustomEvent("truepath:themed"));
  }

  system.addEventListener("change", apply);
  document.addEventListener("truepath:theme", apply);
  apply();
})();

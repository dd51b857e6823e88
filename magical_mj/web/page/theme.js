// @ts-check
/** Marks the page as light or dark: as chosen on the pages of the documentation, or otherwise as the system prefers. */
{
  const system = matchMedia("(prefers-color-scheme: dark)");
  const mark = () => {
    let chosen = null;
    try {
      chosen = localStorage.getItem("theme");
    } catch {}  // storage is forbidden
    document.documentElement.dataset.theme = chosen === "light" || chosen === "dark" ? chosen : system.matches ? "dark" : "light";
  };
  mark();
  system.addEventListener("change", mark);
  addEventListener("pageshow", mark);
}

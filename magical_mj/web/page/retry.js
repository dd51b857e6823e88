// @ts-check
/** Shows that the page's scripts could not be loaded, and offers to try again. It is not a module, so that it always runs. */
addEventListener("error", ({ target }) => {
  if (!(target instanceof HTMLScriptElement)) return;
  const status = document.querySelector("[role=status]"), button = document.createElement("button");
  button.textContent = "Try again";
  button.onclick = () => location.reload();
  status?.replaceChildren("The page could not be loaded completely. ", button);
}, true);

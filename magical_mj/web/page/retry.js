// @ts-check
/** Says that the page's program could not be loaded, and offers to try again. It is no module, so that it runs in any case. */
addEventListener("error", ({ target }) => {
  if (!(target instanceof HTMLScriptElement)) return;
  const status = document.querySelector("[role=status]"), button = document.createElement("button");
  button.textContent = "Try again";
  button.onclick = () => location.reload();
  status?.replaceChildren("The page could not be loaded completely. ", button);
}, true);

// @ts-check
/** Shows what failed, with a button to try again. It is not a module, so that it runs even if no module can be loaded. */

/** @param {string} text @param {() => void} [again] */
function showFailure(text, again = () => location.reload()) {
  const status = document.querySelector("[role=status]"), button = document.createElement("button");
  button.textContent = "Try again";
  button.onclick = again;
  status?.replaceChildren(`${text} `, button);
  status?.classList.add("wrong");
}
addEventListener("error", ({ target, error }) => {
  const script = target instanceof HTMLScriptElement ? target : null;
  if (script && !("optional" in script.dataset)) showFailure("The page could not be loaded completely.");
  else if (error) showFailure(`This failed: ${error.message}.`);
}, true);
addEventListener("unhandledrejection", ({ reason }) => showFailure(`This failed: ${reason?.message ?? reason}.`));

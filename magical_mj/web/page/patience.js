// @ts-check
/** On phones and with data saving, the page waits for the user before it downloads megabytes and uses the processor. */
const { saveData = false, effectiveType = "4g" } = /** @type {any} */ (navigator).connection ?? {};

/** Whether the page waits, and shows a picture of its scene meanwhile. */
export const waits = matchMedia("(pointer: coarse)").matches || saveData || effectiveType !== "4g";

const button = /** @type {HTMLButtonElement} */ (document.getElementById("start"));
const size = document.documentElement.dataset.download;
if (size) button.append(` (${size})`);
button.hidden = !waits;

/** Resolves when the download may begin: at once, or with the first press of anything below the header. @type {Promise<void>} */
export const asked = !waits ? Promise.resolve() : new Promise((resolve) => {
  for (const kind of ["click", "keydown"]) document.querySelector("main")?.addEventListener(kind, () => {
    button.hidden = true;
    resolve();
  }, { once: true });
});

// @ts-check
/** Waits until the participant has agreed to a text. @param {string} text */
export function agreement(text) {
  const [dialog, words, agree] = ["consent", "consent-text", "agree"].map((id) => /** @type {any} */ (document.getElementById(id)));
  words.textContent = text;
  dialog.addEventListener("cancel", (/** @type {Event} */ event) => event.preventDefault());
  dialog.showModal();
  return new Promise((resolve) => {
    agree.onclick = () => {
      dialog.close();
      resolve(null);
    };
  });
}

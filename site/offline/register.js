// @ts-check
/** Registers the service worker, which stores the pages for offline visits, after this page is loaded. */
new PerformanceObserver((loaded, observer) => {
  if (!loaded.getEntries().some((entry) => entry.name.includes("mujoco.wasm"))) return;
  observer.disconnect();
  navigator.serviceWorker?.register("worker.js").catch(() => {});  // some browsers forbid it, and the page works without it
}).observe({ type: "resource", buffered: true });

// @ts-check
/** Has the pages kept for visits without a network, once what this one needs has come. */
new PerformanceObserver((loaded, observer) => {
  if (!loaded.getEntries().some((entry) => entry.name.includes("mujoco.wasm"))) return;
  observer.disconnect();
  navigator.serviceWorker?.register("worker.js").catch(() => {});  // some browsers forbid it, and the page works without
}).observe({ type: "resource", buffered: true });

// @ts-check
/** MuJoCo's WebAssembly build. It is fetched once, with its progress, and compiled during the download. */

/** @type {Promise<any> | null} */
let loading = null;
let failures = 0;  // browsers cache the failure of an address

/** Called with the finished share of the download, 0 to 1. @type {(share: number) => void} */
let tell = () => {};

/**
 * The module. All calls return the same one. After a failure it is fetched again.
 * @returns {Promise<any>}
 */
export function loadMujoco() {
  const again = failures ? `?${failures}` : "";
  const address = (/** @type {string} */ name) => new URL(`mujoco/${name}${again}`, document.baseURI).href;
  loading ??= Promise.all([import(address("mujoco.js")), compiled(address("mujoco.wasm"))])
    .then(([{ default: start }, module]) => start({
      /** @param {any} imports @param {(instance: WebAssembly.Instance, module: WebAssembly.Module) => void} done */
      instantiateWasm: (imports, done) => {
        WebAssembly.instantiate(module, imports).then((instance) => done(instance, module));
        return {};
      },
    }))
    .then((mujoco) => new Promise((resolve) => { setTimeout(() => resolve(mujoco)); }))  // so that the page stays responsive before a model is created
    .catch((error) => {
      loading = null;
      failures += 1;
      throw new Error(`MuJoCo could not be loaded (${error.message})`);
    });
  return loading;
}

/** Sets the listener to the download's progress. @param {(share: number) => void} listener */
export function onProgress(listener) {
  tell = listener;
}

/** @param {string} address */
async function compiled(address) {
  const reply = await fetch(address);
  if (!reply.ok || !reply.body) throw new Error(`${reply.status} ${reply.statusText}`);
  const size = Number(document.documentElement.dataset.wasm) || Number(reply.headers.get("content-length"));
  let loaded = 0, reported = 0;
  const counted = reply.body.pipeThrough(new TransformStream({
    transform(chunk, controller) {
      loaded += chunk.byteLength;
      const share = size && Math.min(1, loaded / size);
      if (share >= reported + 0.01) tell(reported = share);
      controller.enqueue(chunk);
    },
  }));
  return WebAssembly.compileStreaming(new Response(counted, { headers: { "content-type": "application/wasm" } }));
}

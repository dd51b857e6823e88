"""The npm packages for building and testing the site, in out/npm."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from magical_mj.web.npm import Package, fetched

CACHE: Final = Path(__file__).parent.parent / "out" / "npm"
PLAYWRIGHT: Final = Package(
    "playwright-core",
    "1.61.0",
    "caX7TrY3Ml6egyDX0WUcTHDxodl/b51y5wJOdCEA36QviK/s2g081hvmGs8eaE3DWb6NYZQ6BjO/QkNRPenoPA==",
)
"""Drives the browser in the tests; Apache-2.0."""

AXE: Final = Package(
    "axe-core",
    "4.14.1",
    "FHfa+lmNjQZfJz1q8wKqIDwC6DExcHt/pkjNQb09a3NPjCKg2rhu5qb2S4r76ASyFNNtuFooJpZe37OgudVGtQ==",
)
"""Finds accessibility problems; MPL-2.0."""

ONNX_RUNTIME: Final = Package(
    "onnxruntime-web",
    "1.30.0",
    "q0y+JrrtukXSzsBWEMccVfqX25LRmosXHF+CaRJmg8pZClzcV7svNc4rKY3jL02Vb7QmRMDs1SigqR4CXAfKYQ==",
)
"""ONNX Runtime's WebAssembly build, which runs policies; MIT."""
ONNX_FILES: Final = {
    "ort.js": "ort.wasm.min.mjs",
    "wasm.js": "ort-wasm-simd-threaded.mjs",
    "ort.wasm": "ort-wasm-simd-threaded.wasm",
}
"""File of the page for playing -> file in the package's folder dist. Not all servers support the suffix `.mjs`."""

if __name__ == "__main__":  # for the JavaScript tests, which import these packages
    for package in (PLAYWRIGHT, AXE):
        fetched(package, CACHE)

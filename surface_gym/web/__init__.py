"""WebAssembly for browsers, Node.js and Wasmtime, compiled from the source of the CPU's kernels."""

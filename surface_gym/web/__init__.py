"""The kernels as WebAssembly for browsers, Node.js and Wasmtime, compiled from the CPU's source."""

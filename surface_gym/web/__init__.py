"""The kernels as WebAssembly, compiled from the CPU's source: for browsers, node and wasmtime."""

"""The comparison of denoising methods on identical noisy meshes: cases, methods, runs in child processes, report."""

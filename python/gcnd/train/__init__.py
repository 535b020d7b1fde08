"""Training: one loop, its data, its checkpoints. Denoising never imports this."""

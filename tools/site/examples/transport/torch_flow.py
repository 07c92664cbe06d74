"""
Gradients in PyTorch
====================

`clmorph.torch.sinkhorn_divergence` is a loss of PyTorch: tensors go in, a tensor with a gradient
comes out. An optimizer moves points of a noisy cloud onto a spiral.
"""

import matplotlib.pyplot as plt
import numpy as np
import torch

import clmorph.torch

turn = torch.linspace(0.5, 3 * np.pi, 150)
spiral = torch.stack([turn * torch.cos(turn), turn * torch.sin(turn)], 1) / (3 * np.pi)
generator = torch.Generator().manual_seed(0)
points = (0.3 * torch.randn(150, 2, generator=generator)).requires_grad_()
weights = torch.full((150,), 1 / 150)

optimizer = torch.optim.Adam([points], lr=0.03)
shown, losses = {}, []
for step in range(61):
    optimizer.zero_grad()
    loss = clmorph.torch.sinkhorn_divergence(weights, points, weights, spiral, blur=0.05)
    loss.backward()
    if step in (0, 5, 20, 60):
        shown[step] = points.detach().clone()
    losses.append(loss.item())
    optimizer.step()

fig, axes = plt.subplots(1, 4, figsize=(11, 2.9), layout="constrained")
for ax, (step, cloud) in zip(axes, shown.items(), strict=True):
    ax.scatter(*spiral.T, s=6, color="lightgray")
    ax.scatter(*cloud.T, s=6)
    ax.set_title(f"step {step}: {losses[step]:.4f}")
    ax.axis("equal")
    ax.axis("off")

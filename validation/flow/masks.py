"""Masks of tubes, bends and bifurcations from their exact distance, as NRRD."""
import numpy as np


def segment(p, a, b):
    """Distance to the segment from a to b."""
    a, b = np.asarray(a, float), np.asarray(b, float)
    t = np.clip((p - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
    return np.linalg.norm(p - a - t[..., None] * (b - a), axis=-1)


def arc(p, centre, u, v, radius, angle):
    """Distance to an arc that starts at centre + radius u and turns towards v."""
    d = p - np.asarray(centre, float)
    x, y = d @ u, d @ v
    z = d @ np.cross(u, v)
    t = np.clip(np.arctan2(y, x), 0, angle)
    return np.sqrt((x - radius * np.cos(t)) ** 2 + (y - radius * np.sin(t)) ** 2 + z ** 2)


def smooth_min(a, b, k):
    h = np.maximum(k - np.abs(a - b), 0) / k
    return np.minimum(a, b) - h * h * k / 4


def write(path, distance, low, high, voxel, shift=(0, 0, 0)):
    """Voxels whose centres lie inside; `shift` moves the grid, in voxels. Slab by slab."""
    low, high = np.asarray(low, float), np.asarray(high, float)
    n = np.ceil((high - low) / voxel).astype(int)
    origin = low + np.asarray(shift) * voxel
    axes = [origin[i] + voxel * np.arange(n[i]) for i in range(3)]
    slabs = []
    for z in axes[2]:
        y, x = np.meshgrid(axes[1], axes[0], indexing="ij")
        slabs.append(distance(np.stack([x, y, np.full_like(x, z)], -1)) < 0)
    mask = np.array(slabs).astype(np.uint8)
    head = f"NRRD0004\ntype: uint8\ndimension: 3\nspace: left-posterior-superior\nsizes: {n[0]} {n[1]} {n[2]}\nspace directions: ({voxel},0,0) (0,{voxel},0) (0,0,{voxel})\nspace origin: ({origin[0]},{origin[1]},{origin[2]})\nencoding: raw\n\n"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(head.encode() + mask.tobytes())
    return int(mask.sum())

"""A ray-caster in torch: two views of 3D scenes with exact maps, visibility and poses."""

"""A ray-caster in torch: two views of 3D scenes with exact maps, visibility and poses."""

from dgc_pose.render.bank import TextureBank
from dgc_pose.render.options import SceneOptions
from dgc_pose.render.pairs import RenderedPairs, render_pairs
from dgc_pose.render.procedural import procedural_textures
from dgc_pose.render.scene_pair import RenderedPair, render_scene_pair

__all__ = [
    "RenderedPair",
    "RenderedPairs",
    "SceneOptions",
    "TextureBank",
    "procedural_textures",
    "render_pairs",
    "render_scene_pair",
]

"""A ray-caster in torch: two views of 3D scenes with exact maps, visibility and poses."""

from dgc_pose.synthesis.options import SceneOptions
from dgc_pose.synthesis.render.bank import TextureBank
from dgc_pose.synthesis.render.procedural import procedural_textures
from dgc_pose.synthesis.render.rendered_pairs import RenderedPairs, render_pairs
from dgc_pose.synthesis.render.scene_pair import RenderedPair, render_scene_pair

__all__ = [
    "RenderedPair",
    "RenderedPairs",
    "SceneOptions",
    "TextureBank",
    "procedural_textures",
    "render_pairs",
    "render_scene_pair",
]

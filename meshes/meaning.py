"""What each kind of finding in a health report means for the fixtures' rules."""

MEANING = {
    "unused vertices": "no rule uses them",
    "repeated vertices": "faces on them are not neighbours: the paper's rule leaks at such seams; "
    "the certified rule and the inside test are not affected",
    "near vertices": "if they should be one vertex, the seam between them leaks under the paper's "
    "rule and the mesh is not closed; the certified rule holds",
    "degenerate faces": "they have no normal: the paper's rule ignores them; the certified rule "
    "guards them by their nearest point",
    "duplicate faces": "their edges have more than two faces, where the paper's rule finds no "
    "neighbour; the certified rule and the inside test count them once",
    "slivers": "their normals are imprecise: the paper's rule may tilt a plane; the certified "
    "rule checks a plane against the corners first",
    "boundary loops": "the mesh has no inside: the paper's rule guards its outer side only, the "
    "certified rule both sides; a tool that starts inside is not reported",
    "non-manifold edges": "the paper's conditions need one neighbour on each edge and do not hold "
    "here; the certified rule needs none",
    "pinched vertices": "no rule is affected; some repair and remeshing programs are",
    "flipped faces": "the paper's rule guards the wrong side of them and lets the tool through; "
    "the certified rule does not use the winding, but the inside test is wrong",
    "inside-out bodies": "the paper's rule and every face plane guard the wrong side; the "
    "certified rule and the inside test are not affected",
    "one-sided patches": "no winding is right everywhere: only the certified rule guards "
    "both sides",
    "nested bodies": "a cavity or a separate body, as the winding says; so does the inside test",
    "undecided bodies": "whether they face outwards, which of them are cavities, and the volume "
    "are not known; the certified rule is not affected",
    "crowded faces": "there may be more self-intersections and thin walls than were found",
    "self-intersections": "the inside test counts overlaps twice (still inside); the paper's rule "
    "may leak along the cut, which no edge marks; the certified rule holds",
    "thin walls": "with the paper's rule an error of that size can lead through; the certified "
    "rule checks every step and holds",
}  # fmt: skip

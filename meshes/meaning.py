"""What each kind of finding in a health report means for the fixtures' rules."""

MEANING = {
    "unused vertices": "no rule looks at them; they only cost memory",
    "repeated vertices": "faces on them are not neighbours: the paper's rule leaks at such seams; "
    "the certified rule and the inside test do not mind",
    "near vertices": "if they are meant to be one, the seam between them leaks under the paper's "
    "rule and leaves the mesh without an inside; the certified rule still holds",
    "degenerate faces": "they have no normal: the paper's rule passes them over; the certified "
    "rule guards them by their nearest point",
    "duplicate faces": "their edges have more than two faces, where the paper's rule knows no "
    "neighbour; the certified rule and the inside test count them once",
    "slivers": "their normals are imprecise: the paper's rule may put a plane askew; the certified "
    "rule checks a plane against the corners first",
    "boundary loops": "the mesh has no inside: every rule guards what is there, the paper's from "
    "its outer side only, the certified one from both; nothing reports a tool that starts inside",
    "non-manifold edges": "the paper's conditions need one neighbour on each edge and are blind "
    "here; the certified rule needs none",
    "pinched vertices": "no rule needs them apart; some repair and remeshing programs do",
    "flipped faces": "the paper's rule guards the wrong side of them and lets the tool through; "
    "the certified rule does not ask for the winding, but the inside test is off",
    "inside-out bodies": "the paper's rule and every face plane guard the wrong side; the "
    "certified rule and the inside test do not ask",
    "one-sided patches": "no winding is right everywhere: only the certified rule guards "
    "both sides",
    "nested bodies": "a cavity or a body of its own, as its winding says, also where the wall "
    "around it has a hole or a fin; the inside test follows the winding",
    "undecided bodies": "whether they look outwards, and which of them are cavities, is not known, "
    "nor is the volume; the certified rule does not ask",
    "crowded faces": "what was found is so, and there may be more of it; the rules look at what is "
    "near the tool only",
    "self-intersections": "the inside test counts overlaps twice (still inside); the paper's rule "
    "may leak along the cut, which no edge marks; the certified rule holds",
    "thin walls": "with the paper's rule an error of that size is a way through; the certified "
    "rule checks every step and holds",
}  # fmt: skip

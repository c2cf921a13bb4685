"""Names of the places in the arrays that kernels share.

A plane is a row of `PLANE` numbers in every array of planes. All memory of a tick is one block
(`vf.tick.block`): `words` (integers: counts, codes, and the addresses of the parts), and the parts,
arrays of numbers. A tick's results are the part `REPORT` and the planes directly behind it.
"""

from __future__ import annotations

# A plane n·y ≥ o: the record (PLANE,) that fixtures write.
NORMAL = 0  # three numbers
OFFSET = 3  # [m]
FLOOR = 4  # what the tip's path must not sink below [m], see `Planes.floors`
FOOT = 5  # three numbers: the closest point that gave the plane [m]
TRIANGLE = 8  # the caller's index; −1: none
RULE = 9  # a `vf.Rule`
FIXTURE = 10  # number of the fixture that the plane is of
CAPSULE = 11  # number of the body of the instrument that it holds; 0: the tip
POINT = 12  # number of the guarded point that must obey it, a row of `PLACES`
PUSH = 13  # how far the plane pushed the tip back [m]
LIMIT = 14  # while planes are chosen: a mesh point z is behind when n·z is below this [m], …
BUMP = 15  # … of which this is for bumps [m]
PLANE = 16
# Once the planes of a fixture are chosen, in the places of LIMIT and BUMP:
CARRY = LIMIT  # how far its structure takes the plane along past its point in the tick [m]
KEEP = BUMP  # distance to keep from what is behind the plane: standoff and margin [m]

# The words of a block: counts …
JOINTS = 0  # n
ROOM = 1  # planes there is room for
LINKS = 2  # rows of the chain; 0: the arm computes its kinematics in Python
FIXTURES = 3
POINTS = 4  # guarded points: the tip, and the ends of the bodies' axes
# … the state of a tick …
STAGE = 5  # see `WHOLE`
TRIES = 6  # in this stage
COUNT = 7  # planes
LEFT = 8  # rows left for the solver
SOLVER = 9  # a `vf.Solver`: of the last problem …
FOUND_BY = 10  # … and of the optimum
INSIDE = 11  # 1: the tip is inside of something
ANSWER = 12  # Python's answer to a question: a `vf.Solver`, or 1 for yes
BODIES = 13  # how many bodies are guarded beside the tip
STUCK = 14  # 1: the axis of a body meets the mesh
MOVING = 15  # 1: a structure moves in this tick
YIELDS = 16  # MISSES: no step was found that obeys what moves; or AT_RISK
# … and the addresses of its parts.
CHAIN = 17  # (LINKS, chain.LINK)
AXES = 18  # (LINKS, 6) of the joints
NUMBERS = 19  # (SCALARS,) see below
TABLE = 20  # (JOINT_ROWS, n) see below
JACOBIAN = 21  # (6, n) of the tip at the start
JACOBIANS = 22  # (POINTS, 3, n) linear, of the guarded points
PLACES = 23  # (POINTS, 3) guarded points at the start [m]
TRIALS = 24  # (POINTS, 3) at the joint positions that are tried [m]
ERRORS = 25  # (POINTS, 3) linearisation errors [m]
BULGES = 26  # (POINTS,) how far paths may leave their chords [m]
START = 27  # (3, 4) pose of the tip at the start, …
GOAL = 28  # … of the target, …
TIP = 29  # … at the joint positions that are tried, …
BEST = 30  # … and at the best of them
PLANES = 31  # (ROOM, PLANE)
ROWS = 32  # (ROOM, n) the planes' rows G
BOUNDS = 33  # (ROOM,) b of G Δq ≥ b [m]
OTHER_BOUNDS = 34  # (ROOM,) of another attempt [m]
MULTIPLIERS = 35  # (ROOM,) of the last problem [m]
SCRATCH = 36  # of the solver, see `vf.qp.active_set.carve`
SCRATCH_SIZE = 37  # not an address
SOLUTION = 38  # (n,) of the solver asked: u
DUALS = 39  # one for each row left for it
QUEUE = 40  # (certified.HEAP, 3) of the walk
POLYGONS = 41  # (2, certified.CORNERS, 3) of the walk
SEARCHES = 42  # (FIXTURES, SEARCH) integers: what each fixture is and where
SIDES = 43  # (FIXTURES, SIDE) numbers of each fixture
REPORT = 44  # (HEAD + 2 n,) see below
GUARDS = 45  # (POINTS, GUARD) numbers of each guarded point
BODY_TABLE = 46  # (BODIES, BODY) integers: what is guarded beside the tip
MOTIONS = 47  # (FIXTURES, MOTION) how each fixture moves
RECOVERS = 48  # not an address; 1: a step has to gain what is in
GAINS = 49  # (ROOM,) what each plane asks a step to gain, see `attempts.note_gains` [m]
DEFORMS = 50  # not an address; 1: the surface of a fixture deforms
NEEDED = 51  # (ROOM,) what of GAINS a step has to gain at least [m]
SOUGHT = 52  # (ROOM, n) rows of planes that ask a step to gain something, …
SOUGHT_GAINS = 53  # (ROOM,) … and how much [m]
WORDS = 54

# NUMBERS: settings …
STANDOFF = 0  # [m]
TIP_RADIUS = 1  # [m]
LENGTH = 2  # weighs rotation against translation [m/rad]
DAMPING = 3  # [m²]
GAIN = 4  # [N/m]
CAP = 5  # [N]
TIP_REACH = 6  # the tip's longest step [m]
GUARDED = 7  # 1: a fixture certifies the path and not only its end
ASKED = 8  # motion sphere that the fixtures ask for [m]; 0: none does
SAGITTA = 9  # what a step at full speed leaves its chord by [m]
BEYOND = 10  # the ball searched reaches that far beyond the motion sphere [m]
# … and state.
RADIUS = 11  # of the motion sphere [m]
SEARCHED = 12  # ball searched [m]
REACH = 13  # ball that the planes are valid in [m]
ALLOWED = 14  # radius of the part of the motion sphere that the planes are valid in [m]
FARTHEST = 15  # the path must stay within this distance of its start [m]
LONGEST = 16  # the longest step of the tip [m]
DISTANCE = 17  # of the nearest plane's foot [m]
DEFICIT = 18  # to the standoff, the worst [m]
PACED = 19  # share of the solver's step that fits into a tick
SHARE = 20  # of the optimum that is tried
LOW = 21  # bisection
HIGH = 22
BEST_SHARE = 23
DESIRED = 24  # six numbers: the desired step [m]
GIVEN_UP = 30  # what all rows are relaxed by, where they cannot be met [m]
LEAST = 31  # the smallest shortfall of the steps tried [m]
VIOLATION = 32  # see `Step.violation` [m]
MARKS = 33  # four times [s], each at the end of: kinematics, planes, QP, verification
APPROACH = 37  # share of the room above a plane that a tick may use up
SCALARS = 38

# Rows of TABLE, each (n,) …
TASK = 0  # six rows
LOWER, UPPER = 6, 7  # bounds of the step of this tick
LOWEST, HIGHEST = 8, 9  # position limits
SPEED = 10  # the longest step in a tick
HORIZON = 11  # bound on the step of the unconstrained optimum: `LOOK_AHEAD` ticks
TURNS = 12  # 1 for a revolute joint, else 0
POSITION = 13  # q
TRIAL = 14  # joint positions that are tried
CHOSEN = 15  # the best of them
STEP = 16  # the step that shorter ones are parts of
OTHER = 17  # the step of a second optimum
MIX = 18  # a step between the two
JOINT_ROWS = 19

# What a fixture is: integers.
KIND = 0  # see `GIVEN`
NODES, NODE_COUNT = 1, 2  # of the tree: address of (k, 16)
CORNERS, TRIANGLES = 3, 4  # address of (m, 9)
ORDER, SLIVERS, EDGES = 5, 6, 7  # addresses of (m,), (m,), (m, 3)
WALLS, WALL_COUNT = 8, 9  # of a corridor: address of (w, corridor.WALL)
FRAME = 10  # of a corridor: address of its axes (2, 3), its width and its hair
KEEPS = 11  # 1: a checked step stays on its side
NODE_MARGINS, OWN_MARGINS = 12, 13  # addresses of (k,), (m,), see `margins.Margins`
VARIED = 14  # m, or 0: the margin is the same for the whole surface
TOOL = 15  # 1: it guards the bodies of the instrument beside the tip
MOVES = 16  # 1: it moves in this tick
# Of a surface that deforms (else 0), see `vf.tree.shapes`: addresses of the faces of its skeleton
# (m, 3) int32, of its vertices (n, 3) and boxes (k, 6) before and after, and of its shifts (k, 6);
# and numbers that no other shape has: of the shape before, of those between, of the shape after.
FACES, BEFORE, AFTER, BOXES, BOXES_AFTER, SHIFTS = 17, 18, 19, 20, 21, 22
FORM, FORM_BETWEEN, FORM_AFTER = 23, 24, 25
SEARCH = 26

# Numbers of a fixture.
SEEN = 0  # three numbers: position, in its frame, of which the side is known [m]; nan: none
WITHIN = 3  # 1: inside there, 0: outside
MARGIN = 4  # [m], the largest
SEEN_FORM, SEEN_BLEND = 5, 6  # the shape of which the side is known
SIDE = 7

# How a fixture moves: its pose at the start and at the end of the tick, each the rows of the
# rotation and then the translation, how far it turns [rad], and its origin goes, a bound [m]; what
# is added to its margins, and how much of that is new [m]; its blends at the start and at the end.
FROM = 0
TO = 12
SPIN = 24
DRIFT = 25
ADDED = 26
GROWTH = 27
BLEND, BLEND_AFTER = 28, 29
MORE = 30  # by how much the ball to search for the tip is larger in its frame [m]
# How the surface near the tip deforms in the tick, in its frame: the middle of the displacements,
# and how far they are from it at most, three numbers each [m].
SHIFT = 31
SPREAD = 34
# How far anything near the tool is displaced at most, and from that middle [m].
MOST_SHIFT, MOST_SPREAD = 37, 38
MOTION = 39

# Numbers of a guarded point.
ANCHOR = 0  # four numbers: where it is fixed to the chain, see `vf.tick.chain`
THICKNESS = 4  # radius of what is around it [m]
STEP_RADIUS = 5  # how far it can go in a tick [m]
BALL = 6  # ball searched around it [m]
PATH_LIMIT = 7  # its path must stay within this distance of its start [m]
STEP_LIMIT = 8  # its longest step [m]
TWIN = 9  # 1: the end of an axis, whose planes the point before it has too
GUARD = 10

# What a body is: the points at the start and the end of its axis (equal for a ball), the number of
# its capsule, and the point at the centre of its trocar zone, −1: there is none.
FIRST, SECOND, NUMBER, CENTRE = 0, 1, 2, 3
BODY = 4

# REPORT: results of a tick. Behind HEAD: joint positions (n,), limits (n,), then the planes.
REPORT_STATUS, REPORT_SOLVER, REPORT_RADIUS, REPORT_ALLOWED, REPORT_DISTANCE = 0, 1, 2, 3, 4
REPORT_MARKS = 5  # four times [s]
REPORT_FORCE = 9  # three numbers [N]
REPORT_VIOLATION = 12  # [m]
REPORT_TIP = 13  # (3, 4)
HEAD = 25


# Kinds of fixtures (KIND).
GIVEN = 0  # its planes are computed in Python
MESH = 1  # a tree of triangles, certified
WALLED = 2  # a corridor

# Phases of a tick. It asks Python a question by the phase to continue with when it is answered.
BEGIN = 0
PLACED = 1  # asked: START and JACOBIAN
SIDED = 2  # asked: WITHIN of every fixture
FOUND = 3  # asked: the planes of all fixtures, COUNT and REACH
SOLVED = 4  # asked: the solution of the problem in SCRATCH
TRIED = 5  # asked: TIP for the joints at TRIAL
JUDGED = 6  # asked: whether the step to TRIALS leads out
# Other results: a tick that is done returns the number of its planes, 0 or more.
NO_TARGET = 7  # the target is not usable
NO_JOINTS = 8  # the joint positions are not usable
DONE = 9  # only within the tick: there is nothing more to try

# Which step a tick tries (STAGE).
WHOLE = 0  # the optimum, shortened to what fits into a tick
RELAXED = 1  # the same without recovery, which was more than the joints can do
YIELDING = 2  # rows relaxed by one length, the least that can be met: sought by bisection
SHORTER = 3  # a shorter part of it
CORRECTED = 4  # the optimum with rows moved by the linearisation error just measured
PART = 5  # by bisection
RECOVERY = 6  # the least step that recovers; then steps between it and the optimum, by bisection

# How a step is not free of what moves (YIELDS).
MISSES = 1  # it obeys not all planes, and is the one that misses them least
AT_RISK = 2  # it does, but a structure that is known to within a length only may be in the tool

"""The coefficient tables of all schemes, by name, each with its source.

To add a custom scheme, create a `midlie_jax.schemes.Scheme`, which measures its order.
"""

from itertools import pairwise
from typing import Any

from .listing import Listing
from .scheme import BATH as BATH
from .scheme import FLIGHT as FLIGHT
from .scheme import KICK as KICK
from .scheme import Scheme as Scheme
from .scheme import measured_order as measured_order
from .scheme import measured_weak_order as measured_weak_order
from .scheme import own_scheme
from .scheme import run as run

_KRYSL = "Krysl, Explicit time integrators for nonlinear dynamics derived from the midpoint rule, 2004"
E1 = own_scheme("E1", 1, ((FLIGHT, 1.0), (KICK, 1.0)), _KRYSL, use="the paper's first Euler method; EA costs no more")
E2 = own_scheme("E2", 1, ((KICK, 1.0), (FLIGHT, 1.0)), _KRYSL, use="the paper's second Euler method; EA costs no more")
EA = own_scheme(
    "EA",
    2,
    ((KICK, 0.5), (FLIGHT, 0.5), (FLIGHT, 0.5), (KICK, 0.5)),
    _KRYSL,
    use="up to three digits, any torque: the least work per step",
    leading=True,
)
EA_STAR = own_scheme(
    "EA*", 2, ((FLIGHT, 0.5), (KICK, 1.0), (FLIGHT, 0.5)), _KRYSL, use="like EA, with the torque at mid-step"
)


def _composed(name: str, order: int, half: Any, source: str, use: str = "") -> Scheme:
    """An odd palindrome of Verlet steps (half kick, flight, half kick) of these lengths, with adjacent kicks merged."""
    factors = _odd_palindrome(half)
    kicks = tuple((left + right) / 2 for left, right in pairwise((0.0, *factors, 0.0)))
    return _alternating(name, order, KICK, kicks, factors, source, composed=True, use="an inexact flight" + use)


def _alternating(
    name: str,
    order: int,
    first: str,
    outer: tuple[float, ...],
    inner: tuple[float, ...],
    source: str,
    **options: Any,
) -> Scheme:
    """The scheme outer[0], inner[0], outer[1], ..., outer[-1], whose outer stages are of the kind `first`."""
    second = FLIGHT if first == KICK else KICK
    stages = [(first, outer[0])]
    for a, b in zip(inner, outer[1:], strict=True):
        stages += [(second, a), (first, b)]
    return own_scheme(name, order, tuple(stages), source, **options)


def _floats(numbers: Any) -> tuple[float, ...]:
    return tuple(map(float, numbers.split() if isinstance(numbers, str) else numbers))


def _mirrored(half: Any) -> tuple[float, ...]:
    """These numbers, then all but the last in reverse."""
    half = _floats(half)
    return (*half, *half[-2::-1])


def _odd_palindrome(half: Any) -> tuple[float, ...]:
    """`half`, a centre that makes the sum 1, and `half` reversed."""
    half = _floats(half)
    return _mirrored((*half, 1 - 2 * sum(half)))


def _even_palindrome(half: Any) -> tuple[float, ...]:
    """`half`, two equal central entries that make the sum 1, and `half` reversed."""
    half = _floats(half)
    return _repeated((*half, 0.5 - sum(half)))


def _repeated(half: Any) -> tuple[float, ...]:
    """These numbers, then the same in reverse."""
    half = _floats(half)
    return (*half, *reversed(half))


_YOSHIDA, _KAHAN_LI = "Yoshida, Phys. Lett. A 150 (1990) 262", "Kahan & Li, Math. Comp. 66 (1997) 1089"
_FEWEST = ", with the fewest flights at this order"
TRIPLE = _composed("TJ4", 4, (1 / (2 - 2 ** (1 / 3)),), _YOSHIDA, _FEWEST)
SUZUKI = _composed(
    "S4", 4, (1 / (4 - 4 ** (1 / 3)),) * 2, "Suzuki, Phys. Lett. A 146 (1990) 319", "; smaller error than TJ4"
)
YOSHIDA6 = _composed(
    "Y6", 6, "0.78451361047755726382 0.23557321335935813368 -1.17767998417887100695", _YOSHIDA + ", solution A", _FEWEST
)
KAHAN_LI6 = _composed(
    "KL6",
    6,
    "0.39216144400731413928 0.33259913678935943860 -0.70624617255763935981 0.08221359629355080023",
    _KAHAN_LI,
    "; smaller error than Y6",
)
SUZUKI_UMENO8 = _composed(
    "SU8",
    8,
    "0.74167036435061295345 -0.40910082580003159400 0.19075471029623837995 -0.57386247111608226666 "
    "0.29906418130365592384 0.33462491824529818378 0.31529309239676659663",
    "Suzuki & Umeno 1993; Hairer, Lubich & Wanner, Geometric Numerical Integration, V.3.2",
)
KAHAN_LI8 = _composed(
    "KL8",
    8,
    "0.13020248308889008088 0.56116298177510838456 -0.38947496264484728641 0.15884190655515560090 "
    "-0.39590389413323757734 0.18453964097831570709 0.25837438768632204729 0.29501172360931029887",
    _KAHAN_LI,
    "; smaller error than SU8",
)
_BLANES_MOAN = "Blanes & Moan, J. Comput. Appl. Math. 142 (2002) 313"
BM4 = _alternating(
    "BM4",
    4,
    FLIGHT,
    _odd_palindrome("0.0792036964311957 0.353172906049774 -0.0420650803577195"),
    _even_palindrome("0.209515106613362 -0.143851773179818"),
    _BLANES_MOAN + ", S6",
    use="an exact flight, any torque; SRKN6b has the smaller error",
)
SRKN6B = _alternating(
    "SRKN6b",
    4,
    KICK,
    _odd_palindrome("0.0829844064174052 0.396309801498368 -0.0390563049223486"),
    _even_palindrome("0.245298957184271 0.604872665711080"),
    _BLANES_MOAN,
    use="four to six digits, any torque that does not read the momentum",
    leading=True,
)
SRKN11B = _alternating(
    "SRKN11b",
    6,
    KICK,
    _even_palindrome("0.0414649985182624 0.198128671918067 -0.0400061921041533 0.0752539843015807 -0.0115113874206879"),
    _odd_palindrome("0.123229775946271 0.290553797799558 -0.127049212625417 -0.246331761062075 0.357208872795928"),
    _BLANES_MOAN,
    use="six to nine digits, fewer evaluations than SRKN14a",
    leading=True,
)
SRKN14A = _alternating(
    "SRKN14a",
    6,
    FLIGHT,
    _mirrored(
        "0.0378593198406116 0.102635633102435 -0.0258678882665587 0.314241403071477 -0.130144459517415 "
        "0.106417700369543 -0.00879424312851058 0.207305069056835",
    ),
    _even_palindrome(
        "0.091719152624462 0.183983170005006 -0.056534365832888 0.004914688774713 0.143761127168358 0.328567693746804"
    ),
    _BLANES_MOAN,
    use="six digits and more, smaller error than SRKN11b",
    leading=True,
)
# Palindromes of 22 flights with 21 kicks between them, of which 11 and 11 are different; the last is the kick at
# mid-step. They satisfy the 18 conditions of odd order up to 8, in the Lie algebra of flights and kicks for a force
# from a potential, in which brackets with two kicks more than flights vanish (McLachlan & Quispel, Acta Numerica 11
# (2002) 341). The Levenberg-Marquardt method solved them from 48 200 random and 55 000 modified starting points; the
# four free coefficients minimise errors measured on tops, of RKN8G on fast tops. There may be better ones. Blanes,
# Casas & Escorihuela-Tomas (2022, arXiv 2202.01541) have similar ones. `tests/test_order_conditions.py` checks the
# tables by Nystrom trees, which the search did not use.
ORDER_8 = {
    "RKN8": (
        """
0.01478443581767955177181578729926786 0.1000751742346009342364281250359285 0.2737954328923544747401434328544896
-0.1184384533239548409949527561963683 0.114744123781348262531499296558585 -0.2689207270716482250133171943944167
-0.01062919108225956079443189814397679 0.1346656445263386452119448666276559 0.1248807727742239892017782287573347
-0.06850173266853184106687057852621792 0.2035445201198486101759626901277182
""",
        """
0.04285308951731406651217416284306832 0.1849625142030463336493759984166264 0.09605365899863336338725299746015178
0.006578022553000790445311061399415278 -0.1033107473041609102916548463443405 -0.280400282132747186619128930730511
0.2124566228056352973015520756233286 0.1634463653090040438677656711286696 0.1452367242787065266851982689862514
-0.03528965819902839783020717484051921 0.1348273799411921457847214321157187
""",
    ),
    "RKN8G": (
        """
0.03983187044836285786856982353325086 0.1402825601380944729247294679612604 0.2289755256470360829370379942453209
-0.07581595816477438731775165896360564 0.07418012089885637131993478907589231 -0.2356940607699855707510427758325197
-0.0022931449611423741930250841191534 0.1518168126302711590088482203514696 0.186912195804448672335964275333885
-0.1330651581586054450385037992113729 0.1248692364874381609052387476255726
""",
        """
0.09736413899155064253866719732774822 0.1680360227381570493423802268072749 0.3888406081624988407058508118890969
0.01594881508333545218374181433175025 -0.4015033982056980445989310517086999 -0.6168023856338366256931810349983678
0.596320739093125811382282602668773 0.1550392934419539847290370855700616 0.4270520755003114762374071458916051
-0.002443920315198341350216545486329403 -0.6557039777124004909540765045858255
""",
    ),
}


def _of_order_8(name: str, use: str) -> Scheme:
    flights, kicks = ORDER_8[name]
    source = "found by a search for this package: midlie_jax/integrators/schemes.py"
    return _alternating(name, 8, FLIGHT, _repeated(flights), _mirrored(kicks), source, use=use, leading=True)


RKN8 = _of_order_8("RKN8", "seven digits and more, any torque that does not read the momentum")
RKN8G = _of_order_8("RKN8G", "fast tops, nine digits and more; RKN8 has the smaller error on others")
# TI and CHIN4A use the gradient of T . I^-1 T, at the cost of one directional derivative of the torque.
TAKAHASHI_IMADA = own_scheme(
    "TI",
    2,
    ((FLIGHT, 0.5), (KICK, 1.0), (FLIGHT, 0.5)),
    "Takahashi & Imada, J. Phys. Soc. Japan 53 (1984) 3765; effective order 4 between `TAKAHASHI_IMADA_PROCESSOR`s",
    gradients=(1 / 24,),
    use="order 4 with its processor, one torque and its gradient per step; torque from a potential only",
)
_PROCESSOR_STEP = 48**-0.5
# The processor of "TI". Applied before the first step, and inverted after the last step, it raises a run with "TI" to
# order 4. The processor is an even function of the step and equals exp(h^2 [A, B] / 24) up to h^4. A run without it has
# an error of order 2, but is conjugate to a run of order 4: conserved quantities oscillate, and drift no more than at
# order 4.
TAKAHASHI_IMADA_PROCESSOR = (
    *((FLIGHT, -_PROCESSOR_STEP), (KICK, _PROCESSOR_STEP), (FLIGHT, _PROCESSOR_STEP), (KICK, -_PROCESSOR_STEP)),
    *((FLIGHT, _PROCESSOR_STEP), (KICK, -_PROCESSOR_STEP), (FLIGHT, -_PROCESSOR_STEP), (KICK, _PROCESSOR_STEP)),
)
CHIN4A = own_scheme(
    "CHIN4A",
    4,
    ((KICK, 1 / 6), (FLIGHT, 0.5), (KICK, 2 / 3), (FLIGHT, 0.5), (KICK, 1 / 6)),
    "Chin, Phys. Lett. A 226 (1997) 344, scheme A; Koseleff 1993",
    gradients=(0.0, 1 / 48, 0.0),
    use="three to five digits, two torques and one gradient per step; torque from a potential only",
    leading=True,
)
# Derivative-free versions: the torque at a displaced attitude replaces the gradient.
_HESSIAN_FREE = "Schaefers, Finkenrath, Guenther & Knechtli, Hessian-free force-gradient integrators, arXiv 2403.10370"
BADAB = own_scheme(
    "BADAB",
    4,
    CHIN4A.stages,
    f"Yin & Mawhinney, arXiv 1111.5059: Chin's scheme A; {_HESSIAN_FREE}",
    gradients=CHIN4A.gradients,
    displaced=True,
    use="CHIN4A for a torque that cannot be differentiated: three torques per step; not symplectic",
)
_END, _OUTER, _WEIGHT = 0.089775972994422, 0.247597680043986, 0.006911440413815
ABADABA = _alternating(
    "ABADABA",
    4,
    FLIGHT,
    _even_palindrome((_END,)),
    _odd_palindrome((_OUTER,)),
    _HESSIAN_FREE,
    gradients=(0.0, _WEIGHT / (1 - 2 * _OUTER), 0.0),
    displaced=True,
    use="a torque that cannot be differentiated: four torques per step; not symplectic",
)

# For nearly free motion: fast tops in weak fields.
_FAR, _NEAR = ((525 + sign * 70 * 30**0.5) ** 0.5 / 70 for sign in (1, -1))  # Gauss's points on [-1, 1], halved
ABA82 = _alternating(
    "ABA82",
    2,
    FLIGHT,
    _mirrored((0.5 - _FAR, _FAR - _NEAR, 2 * _NEAR)),
    _even_palindrome((0.25 - 30**0.5 / 72,)),
    "McLachlan, BIT 35 (1995) 258: Gauss's quadrature; Laskar & Robutel, Celest. Mech. 80 (2001) 39, SABA4",
    small=8,
    use="fast tops in weak fields, moderate accuracy",
)
ABA1064 = _alternating(
    "ABA1064",
    4,
    FLIGHT,
    _odd_palindrome("0.03809449742241219546 0.14529871611691374940 0.20762769572554125072 0.43590970365152615922"),
    _even_palindrome("0.09585888083707521061 0.20444615314299878068 0.21707034797899110171"),
    "Blanes, Casas, Farres, Laskar, Makazaga & Murua, Appl. Numer. Math. 68 (2013) 58: ABA1064",
    small=10,
    use="fast tops in weak fields, high accuracy",
    leading=True,
)
# With a heat bath, `midlie_jax.baths.Langevin`. A is the flight, B the kick, O the bath (Ornstein and Uhlenbeck).
_LEIMKUHLER = "Leimkuhler & Matthews, Appl. Math. Res. Express 2013, 34"
BAOAB = own_scheme(
    "BAOAB",
    2,
    ((KICK, 0.5), (FLIGHT, 0.5), (BATH, 1.0), (FLIGHT, 0.5), (KICK, 0.5)),
    _LEIMKUHLER,
    use="with a heat bath: start here; positions and attitudes are exact in a harmonic well",
)
OBABO = own_scheme(
    "OBABO",
    2,
    ((BATH, 0.5), (KICK, 0.5), (FLIGHT, 1.0), (KICK, 0.5), (BATH, 0.5)),
    "Bussi & Parrinello, Phys. Rev. E 75 (2007) 056707",
    use="with a heat bath: momenta are exact in a harmonic well; one flight of an exact method, but two baths",
)
ABOBA = own_scheme(
    "ABOBA",
    2,
    ((FLIGHT, 0.5), (KICK, 0.5), (BATH, 1.0), (KICK, 0.5), (FLIGHT, 0.5)),
    _LEIMKUHLER,
    use=("with a heat bath: positions are also exact in a harmonic well; the bath in the middle of EA*"),
)
SCHEMES = {
    scheme.name: scheme
    for scheme in (  # best first
        *(EA, CHIN4A, SRKN6B, SRKN14A, RKN8, RKN8G, SRKN11B, ABA1064, ABA82, BM4),
        *(SUZUKI, TRIPLE, KAHAN_LI6, YOSHIDA6, KAHAN_LI8, SUZUKI_UMENO8),
        *(EA_STAR, TAKAHASHI_IMADA, BADAB, ABADABA, E2, E1),
        *(BAOAB, OBABO, ABOBA),
    )
}


def names() -> Listing:
    """The names of the schemes, best first; the list prints as a table of when to use each scheme.

    Examples:
        >>> ml.schemes.names()[:2]
        ['EA', 'CHIN4A']
    """
    return Listing({name: f"order {scheme.order}: {scheme.use}" for name, scheme in SCHEMES.items()})

from .base import Sum as Sum
from .langevin import Langevin as Langevin
from .recoil import Recoil as Recoil

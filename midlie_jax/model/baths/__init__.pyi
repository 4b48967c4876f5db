from .base import Sum as Sum
from .langevin import Langevin as Langevin
from .langevin import Recoil as Recoil

"""Constants of nature and the fixed numbers that laws share. No formula.

CODATA 2018 (unchanged in 2022): c, h, k and e are exact by the definition of the SI of 2019.
"""

from __future__ import annotations

import math
from typing import Final

SPEED_OF_LIGHT_M_S: Final = 299_792_458.0
"Vacuum; sensors are calibrated in air, so ranges need no index."
PLANCK_J_S: Final = 6.626_070_15e-34
BOLTZMANN_J_K: Final = 1.380_649e-23
ELEMENTARY_CHARGE_C: Final = 1.602_176_634e-19

LN_50: Final = math.log(50.0)
"Koschmieder's constant for two per cent contrast."
MOR_PER_VISIBILITY: Final = math.log(20.0) / math.log(50.0)
"Meteorological optical range (5 %) over visibility (2 %): 0.765776."
DB_PER_NEPER: Final = 10.0 / math.log(10.0)
FWHM_PER_SIGMA: Final = 2.0 * math.sqrt(2.0 * math.log(2.0))
"Full width at half maximum of a Gaussian over its standard deviation."

SUN_HALF_ANGLE_RAD: Final = 4.652e-3
"Angular radius of the sun's disc, mean over the year."
SUN_TEMPERATURE_K: Final = 5772.0
"Effective temperature, IAU 2015 resolution B3."
SUN_TOTAL_W_M2: Final = 1370.0
"Default of the knob `sun_total_w_m2`; value of Hadj-Bachir and de Souza 2019."
SUN_TABLE_TOTAL_W_M2: Final = 1366.1
"Total to which the ASTM G173-03 table is scaled."
SUN_GROUND_GLOBAL_W_M2_NM: Final = {905: 0.749, 1550: 0.268}
"Sun and sky on a plane tilted by 37 degrees, mean over 40 nm, by wavelength in nm; ASTM G173-03."
SUN_GROUND_DIRECT_W_M2_NM: Final = {905: 0.700, 1550: 0.260}
"Direct beam only, mean over 40 nm; ASTM G173-03."
SKY_RADIANCE_W_M2_SR_NM: Final = 0.016
"Clear sky away from the sun at 905 nm. Choice of this project, not measured."

WATER_INDEX_905: Final = 1.327
CLEAR_AIR_VISIBILITY_M: Final = 23_000.0
"Standard clear air; extinction 8.90e-5 1/m at 905 nm by the law of Kim."

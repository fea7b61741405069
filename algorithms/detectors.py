"""The registered CFAR detectors, which `isacbench.dsp.cfar.cfar_detectors` describes."""

from isacbench.dsp.cfar import CaCfar as CaCfar
from isacbench.dsp.cfar import GocaCfar as GocaCfar
from isacbench.dsp.cfar import OscaCfar as OscaCfar
from isacbench.dsp.cfar import OsCfar as OsCfar
from isacbench.dsp.cfar import SocaCfar as SocaCfar
from isacbench.dsp.cfar import TmCfar as TmCfar

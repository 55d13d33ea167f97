"""Which signal of the gateway's own messages carries which value (`enum tx_source`).

A new signal needs a line here and one in `gateway/core/transmit.c`. May know: names of the message
set. May not know: bits, clocks.
"""

from __future__ import annotations

from typing import Final

from _traction_core import lib

OF_A_DRIVE: Final = {
    "Estimate": {
        "Health": lib.TX_HEALTH,
        "Speed": lib.TX_SPEED,
        "LoadTorque": lib.TX_LOAD,
        "LossProbability": lib.TX_LOSS_PROBABILITY,
        "Nis": lib.TX_NIS,
    },
    "Thermal": {
        "FaultClass": lib.TX_FAULT_CLASS,
        "Tmixed": lib.TX_MIXED,
        "Maisd": lib.TX_MAISD,
        "FaultSensor": lib.TX_FAULT_SENSOR,
        "Jumps": lib.TX_JUMPS,
        "DegradationRate": lib.TX_RATE,
    },
    "Adhesion": {
        "Quality": lib.TX_QUALITY,
        "Creep": lib.TX_CREEP,
        "Utilisation": lib.TX_UTILISATION,
        "CreepSigma": lib.TX_CREEP_SIGMA,
        "UtilisationSigma": lib.TX_UTILISATION_SIGMA,
    },
}

OF_THE_SET: Final = {
    "Gateway_Adhesion": (
        {
            "Reason": lib.TX_ADHESION_REASON,
            "Detector": lib.TX_DETECTOR,
            "CommonMode": lib.TX_COMMON_MODE,
            "Age": lib.TX_AGE,
        },
        {"Adhesion": lib.TX_ADHESION},
    ),
    "Gateway_Faults": (
        {
            "Reason": lib.TX_FAULTS_REASON,
            "SensorFault": lib.TX_SENSOR,
            "CommFault": lib.TX_COMM,
            "EstimatorFault": lib.TX_ESTIMATOR,
            "Overrun": lib.TX_OVERRUN,
            "Age": lib.TX_TEMPERATURE_AGE,
        },
        {"Thermal": lib.TX_THERMAL},
    ),
    "Gateway_Info": (
        {
            "ConfigHash": lib.TX_CONFIG_HASH,
            "LatencyP99": lib.TX_LATENCY,
            "LatenessP99": lib.TX_LATENESS,
        },
        {},
    ),
    "Gateway_Status": (
        {
            "State": lib.TX_STATE,
            "DeadlineMisses": lib.TX_DEADLINE_MISSES,
            "RejectedFrames": lib.TX_REJECTED,
            "LostFrames": lib.TX_LOST,
            "BusLoad": lib.TX_BUS_LOAD,
        },
        {},
    ),
}
"""Signals of the whole set, and prefixes of those for every drive, followed by its number."""

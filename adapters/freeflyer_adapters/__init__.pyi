from .device.component import DeviceComponent as DeviceComponent
from .device.device import Device as Device
from .facility.settings import FacilitySettings as FacilitySettings
from .facility.virtual_device import VirtualDevice as VirtualDevice
from .recording.data_frame import read_recording as read_recording

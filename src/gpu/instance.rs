//! The Vulkan instance, its validation layer and the messages that layer sent.

use crate::{Error, Result};
use ash::{ext, vk};
use std::collections::HashMap;
use std::ffi::{CStr, c_void};
use std::sync::Mutex;
use std::thread::ThreadId;

const VALIDATION_LAYER: &CStr = c"VK_LAYER_KHRONOS_validation";

/// Messages by the thread whose call caused them: the layers report in the calling thread.
#[derive(Default)]
pub(super) struct Messages(Mutex<HashMap<ThreadId, Vec<String>>>);

impl Messages {
    fn push(&self, message: String) {
        if let Ok(mut map) = self.0.lock() {
            map.entry(std::thread::current().id()).or_default().push(message);
        }
    }

    pub(super) fn drain(&self) -> Vec<String> {
        self.0.lock().ok().and_then(|mut map| map.remove(&std::thread::current().id())).unwrap_or_default()
    }
}

pub(super) struct Instance {
    pub(super) raw: ash::Instance,
    messenger: Option<(ext::debug_utils::Instance, vk::DebugUtilsMessengerEXT)>,
    /// Boxed: the messenger holds its address.
    pub(super) messages: Box<Messages>,
    // Unloads the library; dropped last.
    pub(super) entry: ash::Entry,
}

unsafe extern "system" fn on_message(
    severity: vk::DebugUtilsMessageSeverityFlagsEXT,
    _kind: vk::DebugUtilsMessageTypeFlagsEXT,
    data: *const vk::DebugUtilsMessengerCallbackDataEXT<'_>,
    user: *mut c_void,
) -> vk::Bool32 {
    // SAFETY: the layer passes valid callback data, and `user` is the boxed `Messages` that outlives the messenger.
    let (messages, text) = unsafe {
        let text = (*data).p_message;
        let text = if text.is_null() { "".into() } else { CStr::from_ptr(text).to_string_lossy() };
        (&*user.cast::<Messages>(), text)
    };
    log::error!("validation ({severity:?}): {text}");
    messages.push(text.into_owned());
    vk::FALSE
}

fn no_loader(e: &ash::LoadingError) -> Error {
    Error::Gpu(format!(
        "no Vulkan loader ({e}); install it, e.g. `apt-get install libvulkan1`, and a driver: the GPU vendor's, or \
         `apt-get install mesa-vulkan-drivers` for Mesa's, which has the CPU driver lavapipe"
    ))
}

impl Instance {
    pub(super) fn new(validation: bool) -> Result<Self> {
        // SAFETY: loads the system's Vulkan loader, which has no preconditions.
        let entry = unsafe { ash::Entry::load() }.map_err(|e| no_loader(&e))?;
        if validation {
            // SAFETY: plain query.
            let layers = unsafe { entry.enumerate_instance_layer_properties() }.map_err(super::device::vk_error)?;
            if !layers.iter().any(|l| l.layer_name_as_c_str() == Ok(VALIDATION_LAYER)) {
                return Err(Error::Gpu(
                    "the Vulkan validation layer is missing; install it, e.g. `apt-get install vulkan-validationlayers`".into(),
                ));
            }
        }
        let app = vk::ApplicationInfo::default().application_name(c"limpid").api_version(vk::API_VERSION_1_3);
        let layers = [VALIDATION_LAYER.as_ptr()];
        let extensions = [ext::debug_utils::NAME.as_ptr()];
        let mut info = vk::InstanceCreateInfo::default().application_info(&app);
        if validation {
            info = info.enabled_layer_names(&layers).enabled_extension_names(&extensions);
        }
        // SAFETY: `info` and what it points to live until the call returns.
        let raw = unsafe { entry.create_instance(&info, None) }.map_err(|e| match e {
            vk::Result::ERROR_INCOMPATIBLE_DRIVER => no_device(),
            other => super::device::vk_error(other),
        })?;
        let messages = Box::<Messages>::default();
        let mut this = Self { raw, messenger: None, messages, entry };
        if validation {
            this.listen()?;
        }
        Ok(this)
    }

    pub(super) fn validates(&self) -> bool {
        self.messenger.is_some()
    }

    fn listen(&mut self) -> Result<()> {
        let loader = ext::debug_utils::Instance::new(&self.entry, &self.raw);
        let user = std::ptr::from_ref::<Messages>(&self.messages).cast_mut().cast::<c_void>();
        let info = vk::DebugUtilsMessengerCreateInfoEXT::default()
            .message_severity(
                vk::DebugUtilsMessageSeverityFlagsEXT::WARNING | vk::DebugUtilsMessageSeverityFlagsEXT::ERROR,
            )
            .message_type(
                vk::DebugUtilsMessageTypeFlagsEXT::VALIDATION | vk::DebugUtilsMessageTypeFlagsEXT::PERFORMANCE,
            )
            .pfn_user_callback(Some(on_message))
            .user_data(user);
        // SAFETY: the instance has the extension; `user` outlives the messenger (see `Drop`).
        let messenger = unsafe { loader.create_debug_utils_messenger(&info, None) }.map_err(super::device::vk_error)?;
        self.messenger = Some((loader, messenger));
        Ok(())
    }
}

pub(super) fn no_device() -> Error {
    Error::Gpu(
        "no Vulkan 1.3 device; install a driver: the GPU vendor's, or `apt-get install mesa-vulkan-drivers` for Mesa's, \
         which has the CPU driver lavapipe"
            .into(),
    )
}

impl Drop for Instance {
    fn drop(&mut self) {
        // SAFETY: children are gone (the device holds this instance), the messenger goes before its user data.
        unsafe {
            if let Some((loader, messenger)) = self.messenger.take() {
                loader.destroy_debug_utils_messenger(messenger, None);
            }
            self.raw.destroy_instance(None);
        }
    }
}

# Included by gRPC's own CMake project: leaves out of its libraries what deltaray never calls (xDS, RLS, Android's
# binder, the parts for Windows), which is half of its 850 files, and precompiles the headers that most of the rest
# begin with. Together they cut the time to a fraction. What is left must link without undefined symbols.
function(deltaray_reduce target)
  get_target_property(sources ${target} SOURCES)
  list(FILTER sources EXCLUDE REGEX "windows|upbdefs-generated\
|/ext/xds/|/lb_policy/(xds|rls)/|/resolver/(xds|google_c2p|binder)/|/transport/binder/|/filters/rbac/\
|/server_config_selector/xds|/credentials/xds/|/cpp/(client|server)/xds_\
|upb-generated/(envoy|udpa|opencensus|xds/(annotations|core|type))/")
  set_property(TARGET ${target} PROPERTY SOURCES ${sources})
  foreach(header security/credentials/credentials.h config/core_configuration.h transport/transport.h)
    target_precompile_headers(${target} PRIVATE
      "$<$<COMPILE_LANGUAGE:CXX>:${CMAKE_CURRENT_SOURCE_DIR}/src/core/lib/${header}>")
  endforeach()
  target_compile_definitions(${target} PRIVATE GRPC_NO_XDS GRPC_NO_RLS)
  target_link_options(${target} PRIVATE -Wl,-z,defs)
endfunction()

# The targets stand once the project's file has been read.
cmake_language(DEFER CALL deltaray_reduce grpc)
cmake_language(DEFER CALL deltaray_reduce grpc++)

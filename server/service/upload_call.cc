#include "server/service/upload_call.h"

#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "deltaray/v1/mesh_service.pb.h"
#include "server/service/mesh_messages.h"
#include "server/service/message_bytes.h"
#include "server/service/message_fields.h"

namespace deltaray {
namespace {

absl::Status ParseUpload(grpc::ByteBuffer bytes, v1::UploadMeshRequest* request) {
  const MessageSlices message(bytes);
  const size_t others = BytesBeside(message, {0, message.size()}, [](const Field& field) {
    return field.number == v1::UploadMeshRequest::kChunkFieldNumber;
  });
  if (absl::Status status = CheckSmall(others, request->GetTypeName()); !status.ok()) return status;
  return ParseMessage(std::move(bytes), request);
}

}  // namespace

grpc::ServerReadReactor<grpc::ByteBuffer>* UploadCall::Start(Calls* calls, const RpcInfo& rpc,
                                                             const UploadBackend& backend, grpc::ByteBuffer* response) {
  auto call = std::make_shared<UploadCall>(calls, backend, response);
  call->weak_self_ = call;
  if (Admit(call, rpc)) {
    MutexLock lock(call->mutex_);
    call->Read();
  }
  return call.get();
}

void UploadCall::Read() {
  if (finished_) return;
  NoteActivity();
  reading_ = true;
  StartRead(&incoming_);
}

void UploadCall::OnReadDone(bool ok) {
  {
    MutexLock lock(mutex_);
    reading_ = false;
  }
  if (ok) {
    RunStep(backend_.disk, [this] { return TakeMessage(); });
    return;
  }
  // Either the client has sent all, or it has gone: a read ends alike. A write fails only in the second case, so the
  // headers of the reply are sent first.
  MutexLock lock(mutex_);
  if (!finished_) StartSendInitialMetadata();
}

void UploadCall::OnSendInitialMetadataDone(bool ok) {
  if (ok) {
    RunStep(backend_.commits, [this] { return Commit(); });
    return;
  }
  MutexLock lock(mutex_);
  FinishOnce(absl::CancelledError("the client has gone"));
}

void UploadCall::OnDrain() {
  MutexLock lock(mutex_);
  FinishOnce(DrainingError());
}

template <typename Step>
void UploadCall::RunStep(WorkerPool* pool, Step step) {
  pool->Run([self = weak_self_.lock(), step] {
    {
      MutexLock lock(self->mutex_);
      if (self->finished_) return;
      self->stepping_ = true;
    }
    const LogScope scope(self->record().request_id);
    const absl::Status status = CatchExceptions(step);
    MutexLock lock(self->mutex_);
    self->stepping_ = false;
    if (!status.ok()) self->FinishOnce(status);
  });
}

void UploadCall::BeforeFinish() {
  // A step that waits for the disk is not begun any more, but may hold the call for long.
  if (!reading_ && !stepping_) incoming_.Clear();
}

absl::Status UploadCall::TakeMessage() {
  v1::UploadMeshRequest request;
  const std::string where = absl::StrCat("message ", messages_, ": ");
  if (absl::Status status = ParseUpload(std::exchange(incoming_, grpc::ByteBuffer()), &request); !status.ok()) {
    return absl::Status(status.code(), absl::StrCat(where, status.message()));
  }
  if (messages_++ == 0) {
    if (!request.has_header()) return absl::InvalidArgumentError("the first message of an upload must hold header");
    absl::StatusOr<Upload::CommitOptions> options = ReadUploadHeader(request.header(), backend_.max_upload_bytes);
    if (!options.ok()) return options.status();
    options_ = *std::move(options);
    absl::StatusOr<std::unique_ptr<Upload>> upload = backend_.store->StartUpload();
    if (!upload.ok()) return upload.status();
    upload_ = *std::move(upload);
  } else {
    if (request.payload_case() != v1::UploadMeshRequest::kChunk) {
      return absl::InvalidArgumentError(
          absl::StrCat(where, "all messages of an upload but the first one must hold chunk"));
    }
    backend_.metrics->CountUploadBytes(request.chunk().size());
    if (absl::Status status = upload_->Append(request.chunk()); !status.ok()) return status;
  }
  MutexLock lock(mutex_);
  Read();
  return absl::OkStatus();
}

absl::Status UploadCall::Commit() {
  if (upload_ == nullptr) {
    return absl::InvalidArgumentError("the upload has no first message, which must hold header");
  }
  options_.read.cancelled = [this] { return cancelled(); };
  absl::StatusOr<Upload::Committed> committed = upload_->Commit(std::move(options_));
  if (!committed.ok()) return committed.status();

  v1::UploadMeshResponse response;
  *response.mutable_mesh() = ToMessage(committed->info);
  response.set_created(committed->created);
  absl::StatusOr<grpc::ByteBuffer> bytes = SerializeReply(response, backend_.max_message_bytes);
  if (!bytes.ok()) {
    return absl::Status(bytes.status().code(),
                        absl::StrCat("mesh ", committed->info.id, " is stored, but ", bytes.status().message()));
  }
  // The mesh is stored: its client is told so, whether there is room for it or not.
  reply_share_.Reply(bytes->Length(), CutOffLater(weak_self_, ReplyLostError()));
  MutexLock lock(mutex_);
  if (finished_) return absl::OkStatus();
  response_->Swap(&*bytes);
  FinishOnce(absl::OkStatus());
  return absl::OkStatus();
}

}  // namespace deltaray
